"""params.yaml: the settings of all packages and of the pipeline."""
