"""The pipeline: one command per stage; `dvc.yaml` connects them."""
