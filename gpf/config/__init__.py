"""params.yaml: gathers the settings that stand in the packages."""
