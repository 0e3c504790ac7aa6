"""The pipeline: one thin command per stage, which `dvc.yaml` strings together."""
