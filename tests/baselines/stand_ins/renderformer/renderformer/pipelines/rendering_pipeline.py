"""Light from lamps by formula in place of what the network learned, without shadows or bounces.

What a pixel sees is the lamp itself, or ρ/π Σ L A |cos| cos' / d² over all lamps whose front is
turned there; times a gain that stands for the weights.
"""

import torch


class RenderFormerRenderingPipeline:
    def __init__(self, model):
        self.model = model

    def to(self, device):
        self.model.to(device)

    @torch.no_grad()
    def __call__(self, triangles, texture, mask, vn, c2w, fov, resolution, torch_dtype):
        assert mask.shape == triangles.shape[:2] and mask.all()
        assert vn.shape == triangles.shape and texture.shape[2:] == (13, 32, 32)
        assert c2w.shape == (1, 1, 4, 4) and fov.shape == (1, 1, 1)
        assert torch_dtype in (torch.float16, torch.float32)
        texture[:, :, -3:] = torch.log10(texture[:, :, -3:] + 1.0)  # in place, as in the original
        image = _look(triangles[0], texture[0, :, :, 16, 16], c2w[0, 0], fov[0, 0, 0], resolution)
        return (image * self.model.gain)[None, None]


def _look(triangles, values, c2w, fov, resolution):
    diffuse, glow = values[:, :3], 10 ** values[:, 10:] - 1
    a, edge, other = triangles[:, 0], *(triangles[:, k] - triangles[:, 0] for k in (1, 2))
    normal = torch.linalg.cross(edge, other)
    area = normal.norm(dim=1) / 2
    normal = normal / (2 * area[:, None])

    pixel = (torch.arange(resolution) + 0.5) / resolution * 2 - 1
    y, x = torch.meshgrid(-pixel, pixel, indexing="ij")
    slope = torch.tan(torch.deg2rad(fov) / 2)
    rays = torch.stack([x * slope, y * slope, -torch.ones_like(x)], -1) @ c2w[:3, :3].T
    rays, eye = rays.reshape(-1, 3), c2w[:3, 3]

    nearest = torch.full((len(rays),), torch.inf)
    seen = torch.full((len(rays),), -1)
    for k in range(len(triangles)):  # Möller and Trumbore
        p = torch.linalg.cross(rays, other[k].expand_as(rays))
        scale = 1 / (p @ edge[k])
        q = torch.linalg.cross(eye - a[k], edge[k])
        u, v, t = (p @ (eye - a[k])) * scale, (rays @ q) * scale, (other[k] @ q) * scale
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-4) & (t < nearest)
        nearest[hit], seen[hit] = t[hit], k

    point = eye + rays * torch.where(seen >= 0, nearest, 0)[:, None]
    received = torch.zeros(len(rays), 3)
    for k in torch.nonzero(glow.sum(1)).ravel():
        way = triangles[k].mean(0) - point
        squared = (way**2).sum(1)
        cosines = (way * normal[seen]).sum(1).abs() * (-way @ normal[k]).clamp(min=0) / squared
        received += (cosines / squared)[:, None] * glow[k] * area[k]
    shown = glow[seen] + diffuse[seen] / torch.pi * received
    return torch.where((seen >= 0)[:, None], shown, 0).reshape(resolution, resolution, 3)
