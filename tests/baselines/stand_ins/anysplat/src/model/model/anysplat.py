"""What the published AnySplat has by these names, without a network: its answer is its weights."""

from types import SimpleNamespace

import torch
from safetensors.torch import load_file


class AnySplat(torch.nn.Module):
    def __init__(self, answer):
        super().__init__()
        self.answer = torch.nn.ParameterDict(
            {name: torch.nn.Parameter(value) for name, value in answer.items()}
        )
        self.decoder = SimpleNamespace(background_color=torch.tensor([1.0, 0.5, 0.25]))

    @classmethod
    def from_pretrained(cls, folder):
        stored = load_file(f"{folder}/model.safetensors")
        return cls({name.removeprefix("answer."): value for name, value in stored.items()})

    def inference(self, images):
        count = len(self.answer["extrinsic"])
        assert images.shape == (1, count, 3, 448, 448) and images.dtype == torch.float32
        assert images.min() >= 0 and 0.5 < images.max() <= 1
        # Pictures in the wrong order, or turned, would go unnoticed otherwise.
        assert (images[0, :, 0, 0, 0] - torch.arange(count) / 10).abs().max() < 0.01
        names = ("means", "covariances", "harmonics", "opacities")
        gaussians = SimpleNamespace(**{name: self.answer[name][None] for name in names})
        cameras = {name: self.answer[name][None] for name in ("extrinsic", "intrinsic")}
        return gaussians, cameras
