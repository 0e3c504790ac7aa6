"""The viewer's frames of a scene, for every layer and size, from its newest field."""

from __future__ import annotations

from collections import OrderedDict
from typing import Literal

import mitsuba as mi
import numpy as np

from gpf.field.field import GaussianPhotonField
from gpf.rendering.aovs import split_layers
from gpf.rendering.correction import corrected
from gpf.rendering.denoiser import GUIDES, ImageDenoiser
from gpf.rendering.denoiser import available as has_denoiser
from gpf.rendering.lights import LightMixer
from gpf.scene.light_groups import Levels
from gpf.scene.views import Keyframe
from gpf.viewing.layers import PhotonPoints, aovs_of, as_ellipses
from gpf.viewing.messages import Layer
from gpf.viewing.screen import Screen

# Photon paths per pass while there is no field.
_PREVIEW_PATHS = 60_000

_PATH_DEPTH = 24

# Level of a light as it is in the scene.
_AS_IT_IS = (1.0, 1.0, 1.0)

# Number of screens that are kept; each has its own kernels.
_MOST_SCREENS = 12

# What a screen shows, its width and height, and whether the camera moves.
_Key = tuple[Layer | Literal["path", "gathered"], tuple[int, int], bool]


class Screens:
    """A screen for each layer and size that is asked for.

    Parameters
    ----------
    field: None while there is none yet; then pictures are passes of photon mapping.
    """

    def __init__(self, scene: mi.Scene, field: GaussianPhotonField | None) -> None:
        self.scene = scene
        self.field: GaussianPhotonField | None = None
        self._screens: OrderedDict[_Key, Screen] = OrderedDict()
        self._ellipses: GaussianPhotonField | None = None
        self._photons: PhotonPoints | None = None
        self._denoisers: dict[tuple[int, int], ImageDenoiser] = {}
        self._mixer: LightMixer | None = None
        if field is not None:
            self.take(field)

    @property
    def lights(self) -> Levels:
        """The level of each group of lights that the field keeps apart."""
        if self._mixer is None:
            return {}
        return {name: self._mixer.levels.get(name, _AS_IT_IS) for name in self._mixer.names}

    @property
    def dimmed(self) -> bool:
        """Whether any light has another level than in the scene."""
        return any(level != _AS_IT_IS for level in self.lights.values())

    def take(self, field: GaussianPhotonField) -> None:
        """Show a new field, keeping the levels of the lights."""
        if self.field is None:
            self._screens.clear()  # they show photon mapping
        self.field = field
        levels: Levels = {}
        if self._mixer is not None:
            levels = self._mixer.levels
            self._mixer.set({})  # restores the emitters
        self._mixer = LightMixer(self.scene, field) if field.lights is not None else None
        if self._mixer is not None and levels:
            self._mixer.set(levels)
        self._update()

    def set_lights(self, levels: Levels) -> None:
        """Set the levels of groups of lights; names that the field does not have are ignored.

        Raises
        ------
        UserError: an emitter cannot be coloured; then nothing changes.
        """
        if self._mixer is not None:
            self._mixer.set({name: level for name, level in levels.items() if name in self.lights})
            self._update("gaussians")  # the others have the field itself
            self._photons = None

    def layer(self, wanted: Layer) -> Layer:
        """The layer to show for the wanted one: the picture, if the field lacks that layer."""
        if wanted == "photons":
            return wanted
        lacks_error = wanted == "error" and (self.field is None or self.field.error is None)
        return "image" if self.field is None or lacks_error else wanted

    def screen(self, layer: Layer, size: tuple[int, int], moving: bool) -> Screen:
        """The screen for a layer, with the denoiser's inputs if the camera is at rest."""
        key: _Key = (layer, size, moving)
        if key not in self._screens:
            if self.field is None:
                integrator = mi.load_dict({"type": "sppm", "photons_per_pass": _PREVIEW_PATHS})
            else:
                integrator = mi.load_dict(
                    {
                        "type": "gpf",
                        "record": True,
                        "aovs": aovs_of(layer, guides=not moving and has_denoiser()),
                    }
                )
                integrator.field = self._field_of(layer)
            self._add(key, integrator)
        return self._used(key)

    def path_screen(self, size: tuple[int, int]) -> Screen:
        """The screen for path tracing the scene."""
        key: _Key = ("path", size, False)
        if key not in self._screens:
            self._add(key, mi.load_dict({"type": "path", "max_depth": _PATH_DEPTH}))
        return self._used(key)

    @property
    def corrects(self) -> bool:
        """Whether pictures of cameras at rest are corrected by gathered light."""
        return has_denoiser() and self.field is not None and self.field.caustics is not None

    def gathered(self, camera: Keyframe, size: tuple[int, int]) -> np.ndarray:
        """Two pictures by gathered light, one sample per pixel each, (2, H, W, 3)."""
        key: _Key = ("gathered", size, False)
        if key not in self._screens:
            integrator = mi.load_dict({"type": "gpf", "gather": "always"})
            integrator.field = self.field
            self._add(key, integrator)
        screen = self._used(key)
        return np.stack([screen.frame(camera)[..., :3] for _ in range(2)])

    def photons(self, camera: Keyframe, size: tuple[int, int]) -> np.ndarray:
        """Photons as points, display values (H, W, 3) uint8."""
        if self._photons is None:
            self._photons = PhotonPoints(self.scene)
        return self._photons.draw(camera, size)

    def denoised(self, image: np.ndarray, halves: np.ndarray | None = None) -> np.ndarray | None:
        """The denoised picture (H, W, 3) of an image (H, W, C) from a camera at rest; None without
        a field or denoiser. ``halves``: pictures by gathered light, (2, H, W, 3), correct it."""
        if self.field is None or not has_denoiser():
            return None
        layers = split_layers(image, GUIDES)
        size = image.shape[1], image.shape[0]
        if size not in self._denoisers:
            self._denoisers = {size: ImageDenoiser(size, prefilter=True, quality="fast")}
        denoiser, guides = self._denoisers[size], [layers[g] for g in GUIDES]
        clean = denoiser.denoise(layers["radiance"], *guides)
        return clean if halves is None else corrected(clean, halves, guides[1], denoiser)

    def _update(self, only: Layer | None = None) -> None:
        """Set the field of all screens again, or of those of one layer."""
        self._ellipses = None
        for (layer, *_), screen in self._screens.items():
            if layer != "path" and only in (None, layer):
                screen.integrator.field = self._field_of(layer)

    def _field_of(self, layer: str) -> GaussianPhotonField | None:
        if layer != "gaussians" or self.field is None:
            return self.field
        self._ellipses = self._ellipses or as_ellipses(self.field)
        return self._ellipses

    def _add(self, key: _Key, integrator: mi.Integrator) -> None:
        self._screens[key] = Screen(self.scene, integrator, key[1])
        while len(self._screens) > _MOST_SCREENS:
            self._screens.popitem(last=False)

    def _used(self, key: _Key) -> Screen:
        self._screens.move_to_end(key)
        return self._screens[key]
