"""Dim and colour the lights of a scene and of its field.

Light adds up: the irradiance of a field is a sum over groups of emitters, and each level multiplies
the part of its group (:mod:`gpf.field.lights`). The emitters themselves, which cameras see and
whose direct light may be sampled, get the same factors.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.errors import UserError
from gpf.core.structs import from_numpy
from gpf.field.field import GaussianPhotonField
from gpf.field.lights import FieldLights
from gpf.scene.light_groups import Levels, emitter_names, parse_levels

# What Mitsuba's emitters call their radiance, intensity or irradiance, in one colour or a texture.
_VALUES = tuple(
    f"{name}.{kind}"
    for name in ("radiance", "intensity", "irradiance")
    for kind in ("value", "data")
)


class LightMixer:
    """Sets the levels of a field's groups of emitters, in the field and in the scene.

    Attributes
    ----------
    levels: the levels that were set last.

    Raises
    ------
    UserError: the field does not keep groups apart, or the scene has other emitters.
    """

    def __init__(self, scene: mi.Scene, field: GaussianPhotonField) -> None:
        self.lights: FieldLights = require_lights(field)
        # Emitters that outlive the shapes of their scene make Dr.Jit crash in the next scene.
        self._scene = scene
        self._field = field
        self._caustics = field.caustics
        self.levels: Levels = {}
        self._emitters = [_Dimmed(emitter) for emitter in scene.emitters()]
        self._names = emitter_names(scene)
        if sum(map(len, self.lights.groups.members)) != len(self._emitters):
            raise UserError(
                "lights", "in the field belong to another scene", "Fit the field to this scene."
            )

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the groups."""
        return self.lights.groups.names

    def set(self, levels: Levels) -> None:
        """Set the levels; groups that are not listed get 1.

        Raises
        ------
        UserError: an emitter cannot be coloured; nothing is changed then.
        """
        wanted = [(1.0, 1.0, 1.0)] * len(self._emitters)
        for name, members in zip(self.names, self.lights.groups.members, strict=True):
            for k in members:
                wanted[k] = levels.get(name, (1.0, 1.0, 1.0))
        for emitter, name, level in zip(self._emitters, self._names, wanted, strict=True):
            emitter.check(name, level)
        for emitter, level in zip(self._emitters, wanted, strict=True):
            emitter.set(level)
        # How much of each group's light is caustics is not known.
        self._field.caustics = self._caustics if _as_it_is(levels) else None
        self._field.recolour(self.lights.at(levels))
        if self._field.volume is not None:
            self._field.volume.set_levels(levels)
        self.levels = levels


def require_lights(field: GaussianPhotonField) -> FieldLights:
    """The light of a field by groups; a :class:`UserError` if it does not keep them apart."""
    if field.lights is None:
        raise UserError(
            "lights", "are not kept apart in this field", "Fit it with `gpf fit --groups auto`."
        )
    return field.lights


def set_lights(scene: mi.Scene, field: GaussianPhotonField, text: str) -> None:
    """Set levels given as text (:func:`parse_levels`) in a scene and its field."""
    mixer = LightMixer(scene, field)
    mixer.set(parse_levels(text, mixer.names))


@contextmanager
def mixed(scene: mi.Scene, field: GaussianPhotonField, levels: Levels) -> Iterator[None]:
    """Set levels in a scene and its field, temporarily; if all are 1, nothing changes."""
    if _as_it_is(levels):
        yield
        return
    mixer, before = LightMixer(scene, field), field.gaussians
    try:
        with dr.suspend_grad():
            mixer.set(levels)
        yield
    finally:
        with dr.suspend_grad():
            mixer.set({})
        field.gaussians = before  # whose arrays may be parameters


def _as_it_is(levels: Levels) -> bool:
    return all(level == (1.0, 1.0, 1.0) for level in levels.values())


class _Dimmed:
    """An emitter with its original values."""

    def __init__(self, emitter: mi.Emitter) -> None:
        self._parameters = mi.traverse(emitter)
        keys = [key for key in self._parameters.keys() if key.endswith(_VALUES)]  # noqa: SIM118
        if emitter.class_name() == "EnvironmentMapEmitter":
            keys = ["data"]
        # Copies: an update may write into the arrays.
        self._values = {key: _copy(self._parameters[key]) for key in keys}
        self._level = (1.0, 1.0, 1.0)

    def check(self, name: str, level: tuple[float, float, float]) -> None:
        """Raise a :class:`UserError` if the emitter cannot have this level."""
        grey = level[0] == level[1] == level[2]
        if not self._values and level != (1.0, 1.0, 1.0):
            raise UserError(f"lights: {name}", "cannot be dimmed", "Leave it at 1.")
        if not grey and any(isinstance(value, mi.Float) for value in self._values.values()):
            raise UserError(
                f"lights: {name}",
                "has a grey radiance, which cannot be coloured",
                "Give it an <rgb> in the scene file, and fit again.",
            )

    def set(self, level: tuple[float, float, float]) -> None:
        """Multiply the original radiance."""
        if level == self._level:
            return
        for key, value in self._values.items():
            changed = _times(value, level)
            dr.make_opaque(changed)
            self._parameters[key] = changed
        self._parameters.update()
        self._level = level


def _copy(value: Any) -> Any:
    return type(value)(value)


def _times(value: Any, level: tuple[float, float, float]) -> Any:
    if isinstance(value, mi.TensorXf):
        channels = value.shape[-1]
        factors = np.ones(channels, np.float32)
        factors[: min(3, channels)] = level[: min(3, channels)]
        return from_numpy(mi.TensorXf, np.array(value) * factors)
    return (
        value * level[0] if isinstance(value, mi.Float) else type(value)(value * mi.Color3f(level))
    )
