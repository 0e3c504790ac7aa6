"""What the published RenderFormer has by these names, without a network: see the pipeline."""

from types import SimpleNamespace

import torch
from safetensors.torch import load_file

from renderformer.pipelines.rendering_pipeline import RenderFormerRenderingPipeline

__all__ = ["RenderFormer", "RenderFormerRenderingPipeline"]


class RenderFormer(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.config = SimpleNamespace(use_ldr=False)
        self.gain = torch.nn.Parameter(torch.full((1,), torch.nan))

    @classmethod
    def from_pretrained(cls, folder):
        model = cls()
        model.load_state_dict(load_file(f"{folder}/model.safetensors"), strict=False)
        print("loading")  # the published code prints as well
        return model
