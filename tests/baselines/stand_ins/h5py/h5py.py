"""As much of h5py as scene files need, for machines without it: arrays of numpy, one file each."""

from pathlib import Path

import numpy as np


class File:
    def __init__(self, path, mode):
        self.path, self.mode, self.values = Path(path), mode, {}
        if mode != "w":
            with np.load(self.path) as stored:
                self.values = {name: stored[name] for name in stored.files}

    def create_dataset(self, name, data, compression=None, compression_opts=None):
        self.values[name] = data.copy()

    def __getitem__(self, name):
        return self.values[name]

    def __enter__(self):
        return self

    def __exit__(self, *error):
        if self.mode != "r":
            with self.path.open("wb") as file:
                np.savez(file, **self.values)
