"""Derivatives of pictures that a field gives.

Camera walks are detached: which way they go, and how often each way is tried, counts as fixed. At
the visible point, the radiance L = L_e + β (ρ/π E + L_d) is evaluated again with derivatives: the
diffuse part of the surface, ρ and L_d, the field's answer E, and, for points that a camera sees
directly, the place x itself. The light that the field stores is held fixed when surfaces change.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import fields, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.camera.haze import lit_by
from gpf.camera.visible_points import light_of, walk
from gpf.core.structs import to_numpy
from gpf.field.gaussians import Gaussians
from gpf.rendering.lights import mixed, require_lights
from gpf.rendering.walks import Walks
from gpf.scene.light_groups import Levels, parse_levels
from gpf.scene.materials import diffuse_reflectance
from gpf.training.differentiable_query import query

# Which arrays of the Gaussians are parameters: all but the normals.
_TRAINED = tuple(f.name for f in fields(Gaussians) if f.name != "normals")

# The values of materials that have derivatives.
_DIFFUSE = {"reflectance", "diffuse_reflectance", "base_color"}

_NOT_RGB = {"Y", "YA", "XYZ", "XYZA"}

# What has no derivative here, by the class of the object that owns it.
_FIXED = {
    mi.Emitter: "a value of an emitter: a field with groups has levels instead",
    mi.Shape: "a part of the geometry",
    mi.Medium: "a value of a medium",
    mi.PhaseFunction: "a value of a phase function",
}


def attached_radiance(
    walks: Walks, sampler: mi.Sampler, ray: mi.Ray3f, active: mi.Bool
) -> tuple[mi.Color3f, mi.Bool]:
    """Radiance of camera rays, W/(m² sr), (N, 3), attached to whatever parameters are, and whether
    surfaces end or turn them, (N,)."""
    scene, field = walks.scene, walks.field
    with dr.suspend_grad():
        depths = walks.max_depth, walks.rr_depth
        start = dr.detach(ray)
        points, _, haze, arrival = walk(scene, sampler, mi.Ray3f(start), *depths, active)
        if (volume := field.volume) is not None:
            lamps = volume.fluence.settings.sampled_lamps(scene)
            points.emission += haze.radiance(volume.scattered(haze) + lit_by(lamps, haze, sampler))
        sampler.schedule_state()
        dr.eval(points, arrival)
    direct = points.valid & (points.depth == 0)
    last = mi.Ray3f(arrival.ray)
    last.o, last.d = dr.select(direct, ray.o, last.o), dr.select(direct, ray.d, last.d)
    si = scene.ray_intersect(last, mi.RayFlags.All, coherent=False, active=points.valid)
    bsdf = si.bsdf()
    light = light_of(field.settings.sampled_lamps(scene), sampler, bsdf, si, points.valid, arrival)
    lit = dr.select(points.valid, points.throughput * light, 0)
    shown = replace(
        points,
        reflectance=diffuse_reflectance(bsdf, si, points.valid),
        emission=points.emission + lit,
    )
    value = query(field, field.gaussians, si.p, points.n, points.valid)
    return field.reflect(shown, value), points.opaque()


class DifferentiableField(mi.ad.integrators.common.ADIntegrator):
    """An integrator whose field can be optimised.

    ``mi.traverse`` shows the arrays of its Gaussians (``field.means`` and so on; positions and
    sizes are in the unfolded space if the field has levels, see :mod:`gpf.field.detail`), and the
    levels of the groups of emitters that the field keeps apart (``levels.<group>``).

    Attributes
    ----------
    field: the field, or None.
    lights: levels of groups of emitters, as text.
    levels: further factors for them, a colour each.
    """

    field: Any
    lights: str
    levels: dict[str, mi.Color3f]
    adaptive: bool
    denoise: bool

    def traverse(self, callback: mi.TraversalCallback) -> None:
        """Show the parameters to ``mi.traverse``."""
        if self.field is None:
            return
        flags = mi.ParamFlags.Differentiable
        for name in _TRAINED:
            callback.put(f"field.{name}", getattr(self.field.gaussians, name), flags)
        lights = self.field.lights
        for name in () if lights is None else lights.groups.names:
            level = self.levels.setdefault(name, mi.Color3f(1))
            callback.put(f"levels.{name}", level, flags)

    def parameters_changed(self, keys: Collection[str]) -> None:
        """Renew what depends on the field's arrays.

        Groups of emitters are no longer kept apart after the irradiance was set.
        """
        changed = {key.removeprefix("field.") for key in keys} & set(_TRAINED)
        if not changed or self.field is None:
            return
        attached = self.field.gaussians
        arrays = {f.name: dr.detach(getattr(attached, f.name)) for f in fields(Gaussians)}
        for name in sorted(changed):
            if not dr.all(dr.isfinite(arrays[name]), axis=None):
                raise RuntimeError(f"field.{name} has values that are not finite.")
        if changed == {"irradiance"}:
            self.field.recolour(to_numpy(arrays["irradiance"]))
        else:
            self.field.update(Gaussians(**arrays), self.field.error)
        if "irradiance" in changed:
            self.field.lights = None
            self.levels.clear()
        self.field.gaussians = attached

    def render_forward(
        self, scene: mi.Scene, params: Any, sensor: Any = 0, seed: Any = 0, spp: int = 0
    ) -> mi.TensorXf:
        """How the image changes with the parameters, as for every Mitsuba integrator."""
        change = None
        if self._asks_for_more_than_levels(params):
            with mixed(scene, self.field, self.wanted_levels()):
                change = super().render_forward(scene, params, sensor, seed, spp)
        if (image := self._by_levels(scene, sensor, seed, spp)) is not None:
            by_levels = dr.forward_to(image)
            change = by_levels if change is None else change + by_levels
        return change

    def render_backward(
        self,
        scene: mi.Scene,
        params: Any,
        grad_in: mi.TensorXf,
        sensor: Any = 0,
        seed: Any = 0,
        spp: int = 0,
    ) -> None:
        """Gradients of the parameters from that of the image, as for every Mitsuba integrator."""
        wanted = np.array(grad_in)
        if not np.isfinite(wanted).all():
            raise RuntimeError("The gradient of the image is not finite.")
        if (aovs := len(self.aov_names())) and wanted[..., -aovs:].any():
            raise RuntimeError("AOVs have no derivative: only use the colours of the image.")
        if self._asks_for_more_than_levels(params):
            with mixed(scene, self.field, self.wanted_levels()):
                super().render_backward(scene, params, grad_in, sensor, seed, spp)
        if (image := self._by_levels(scene, sensor, seed, spp)) is not None:
            dr.set_grad(image, grad_in)
            dr.enqueue(dr.ADMode.Backward, image)
            dr.traverse(dr.ADMode.Backward)
        for key, value, _ in _attached(params):
            gradient = dr.grad(value)
            if hasattr(type(gradient), "matrix"):  # of a transform
                gradient = gradient.matrix
            if not np.isfinite(np.array(gradient)).all():
                raise RuntimeError(f"The gradient of {key} is not finite.")

    def wanted_levels(self) -> Levels:
        """The levels of the groups of emitters, as plain numbers."""
        if self.field is None or not (self.lights or (self.levels and self.field.lights)):
            return {}
        names = require_lights(self.field).groups.names
        wanted = parse_levels(self.lights, names)
        for name, level in self.levels.items():
            if name not in names:  # of an earlier field
                continue
            factors = (float(dr.slice(dr.detach(channel))) for channel in level)
            before = wanted.get(name, (1.0, 1.0, 1.0))
            r, g, b = (x * y for x, y in zip(before, factors, strict=True))
            wanted[name] = r, g, b
        return wanted

    def _by_levels(self, scene: mi.Scene, sensor: Any, seed: Any, spp: int) -> mi.TensorXf | None:
        """The image as a sum over those groups of emitters whose levels are attached, (H, W, C);
        None without any. Light is linear, so the derivatives are pictures of the groups."""
        if not (self.levels and self.field.lights):
            return None
        total, names = None, require_lights(self.field).groups.names
        before = parse_levels(self.lights, names)
        levels = {name: self.levels[name] for name in names if name in self.levels}
        for name in (name for name, level in levels.items() if dr.grad_enabled(level)):
            only = dict.fromkeys(names, (0.0, 0.0, 0.0)) | {name: before.get(name, (1.0, 1.0, 1.0))}
            with dr.suspend_grad(), mixed(scene, self.field, only):
                image = super().render(scene, sensor, seed, spp)
            film = scene.sensors()[sensor].film() if isinstance(sensor, int) else sensor.film()
            if film.bitmap().pixel_format().name in _NOT_RGB:
                raise RuntimeError("Levels have derivatives in films of RGB only.")
            channels = image.shape[-1]
            factors = [*self.levels[name], *[mi.Float(0)] * (channels - 3)]
            part = image * mi.TensorXf(dr.concat(factors), (1, 1, channels))
            total = part if total is None else total + part
        return total

    def _asks_for_more_than_levels(self, parameters: mi.SceneParameters | None) -> bool:
        """Whether anything else is attached. Without ``parameters``, that is unknown.

        Raises
        ------
        RuntimeError: an attached parameter has no derivative here.
        """
        for name, what in (("adaptive", "adaptive samples"), ("denoise", "the denoiser")):
            if getattr(self, name):
                raise RuntimeError(
                    f'The gpf integrator: {what} cannot be differentiated. Set "{name}" to false.'
                )
        asks = parameters is None
        for key, _, owner in _attached(parameters):
            if isinstance(owner, mi.BSDF) and not _DIFFUSE & set(key.split(".")):
                raise RuntimeError(
                    f"The gpf integrator has no derivative with respect to {key}: among the values "
                    "of a material, only those of its diffuse reflectance have one."
                )
            group = f".{key}".partition(".levels.")[2] if owner is self else ""
            if group and group not in self.levels:
                raise RuntimeError(
                    f"The gpf integrator has no derivative with respect to {key}: the field no "
                    "longer keeps groups of emitters apart, because its irradiance was set."
                )
            asks |= not group
            for kind, what in _FIXED.items():
                if isinstance(owner, kind):
                    raise RuntimeError(
                        f"The gpf integrator has no derivative with respect to {key}, {what}."
                    )
        return asks


def _attached(parameters: mi.SceneParameters | None) -> Iterator[tuple[str, Any, Any]]:
    """The attached parameters with their names and their owners."""
    if parameters is None:
        return
    for key, value in parameters.items():
        if dr.grad_enabled(value):
            owner = parameters.properties[key][2]
            while isinstance(owner, mi.Texture | mi.Volume):  # of whatever has it
                owner = parameters.hierarchy[owner][0]
            yield key, value, owner
