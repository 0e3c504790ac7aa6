"""Streaming supervision: targets from the photons of any number of passes.

Training does not need converged targets: the noise of many points averages out over a Gaussian. The
photons of all passes are kept, so that a field can be fitted after some passes, and again after
more.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Annotated

import drjit as dr
import mitsuba as mi
import numpy as np
from pydantic import Field

from gpf.core.errors import uninterrupted
from gpf.core.random import Stream, pass_seed
from gpf.core.settings import Count, Positive, Seed, Settings
from gpf.core.structs import VisiblePoints, concatenate, take, to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.photons.emission import Source, emit_light
from gpf.scene.lamps import Lamps
from gpf.scene.light_groups import LightGroups
from gpf.sppm.fixed_points import FixedPoints
from gpf.sppm.passes import PassSettings, suit_scene
from gpf.training.direct_light import DirectLight
from gpf.training.gathered_light import GatheredLight
from gpf.training.kernel_width import WIDTHS, choose_kernels, kernel_blur, pick
from gpf.training.photon_light import PhotonLight
from gpf.training.sampled_light import SampledLight, balance, some_runs
from gpf.training.targets import Targets, source_numbers
from gpf.training.volume_light import VolumeLight

BALANCED = 6, 12, 48, 192
"""Numbers of passes after which the noise of the photons is compared with that of samples."""


class StreamSettings(Settings):
    """Settings of the stream: its passes, and the supervised points.

    Attributes
    ----------
    passes: photon passes in all.
    alpha: radius reduction, in (0, 1).
    radius: radius of the first pass, in units of the references' first radius.
    view_points, surface_points: largest numbers of supervised points that training views see, and
        of supervised samples of surfaces.
    """

    passes: Count = 300
    alpha: Annotated[float, Field(gt=0, lt=1)] = 0.75
    radius: Positive = 1.3
    view_points: Count = 200_000
    surface_points: Count = 300_000
    seed: Seed = 6

    def passes_like(self, passes: PassSettings) -> PassSettings:
        """The settings of the stream's passes, given those of the references' passes."""
        radius = self.radius * passes.initial_radius
        return passes.model_copy(update={"alpha": self.alpha, "initial_radius": radius})


class PhotonStream:
    """Photons of a growing number of passes, and the targets that they give at fixed points.

    Photons are added up in cells (:class:`gpf.photons.photon_grid.PhotonSums`), so the cost of a
    pass does not depend on the number of points. For targets, all photons of n passes are gathered
    with the radius of pass n of SPPM or, where light is sharp, with half or a quarter of it
    (:mod:`gpf.training.kernel_width`). Odd-numbered and even-numbered passes are added up
    separately: these two halves are independent.

    Parameters
    ----------
    settings: settings of the passes; ``alpha`` and ``initial_radius`` determine the radius.
    points: sets of points by name: each training view in order, then
        :data:`gpf.training.targets.SURFACES`; any of them may be missing.
    lamps: the emitters whose direct light the targets contain; by default all.
    groups: groups of emitters whose light is kept apart, for :meth:`by_group`.
    volume: takes the photons in media; then no light is gathered by rays, which know no media.

    Attributes
    ----------
    gathered: the light of diffuse surfaces if it is gathered (:meth:`light_by`), or None.
    caustics: irradiance of the points of the last call of :meth:`halves` by photons of each half
        that have met something specular since they left a lamp or a diffuse surface, (2, N, 3);
        None if photons also bring direct light, or where there are media.
    blur: squared error that the width of the kernels adds to the targets of the last call of
        :meth:`halves` (:func:`gpf.training.kernel_width.kernel_blur`), (N,).
    """

    def __init__(
        self,
        scene: mi.Scene,
        settings: PassSettings,
        points: Mapping[str, VisiblePoints],
        seed: int,
        source: Source = emit_light,
        lamps: Lamps | None = None,
        groups: LightGroups | None = None,
        volume: VolumeLight | None = None,
    ) -> None:
        self.scene, self.seed, self._groups = scene, seed, groups
        settings = suit_scene(settings, scene)
        # The lamps whose direct light is sampled and added to that of the photons. If photons bring
        # all direct light, what the targets should not contain is sampled and subtracted.
        sampled, sign = Lamps(scene) if lamps is None else lamps, 1
        if settings.direct == "photons":
            sampled, sign = sampled.others(), -1
        valid = [take(each, dr.compress(each.valid)) for each in points.values()]
        self._source = np.repeat(source_numbers(points), [dr.width(each.p) for each in valid])
        self._points = FixedPoints(scene, concatenate(valid))
        self.photons = PhotonLight(self._points, settings, seed, source, groups, volume)
        self._direct = DirectLight(self._points, sampled, sign, seed)
        self._by_photons = sign < 0
        self.gathered: GatheredLight | None = None
        self._rows = slice(None)
        self._kernel = np.zeros(len(self._source), np.uint8)
        self.blur = np.zeros(len(self._source), np.float32)
        self.caustics: np.ndarray | None = None

    @property
    def count(self) -> int:
        """Number of passes so far."""
        return self.photons.passes

    @property
    def narrowest(self) -> float:
        """Radius of the narrowest kernel with which photons are gathered, world units."""
        return WIDTHS[-1] * self.photons.radius

    def advance(
        self, count: int, tick: Callable[[int], None] = lambda done: None, balances: bool = True
    ) -> None:
        """Add passes until there are ``count``; ``tick(done)`` is called after each. ``balances``:
        whether the number of samples follows from their noise (:data:`BALANCED`)."""
        while self.count < count:
            with uninterrupted():
                # Groups of lights still need to know whose light the diffuse surfaces send.
                self.photons.add_pass(self.gathered is None or self._groups is not None)
            if balances and self.count in BALANCED and (self._direct.lamps or self.gathered):
                self._balance()
            if self._direct.per_pass > 0 or self.gathered:
                self.sample()
            tick(self.count)

    def light_by(self, field: GaussianPhotonField) -> None:
        """From now on, gather the light of diffuse surfaces by rays that end in a field of the same
        scene; photons that bring this light no longer count. Nothing changes in media."""
        if self.photons.volume is not None:
            return
        gathered = self._gathered_by(field, self.count)
        gathered.add()  # compiles, so its time is no measure
        self.gathered = gathered
        self._balance()
        self.sample()

    @property
    def sample_seconds(self) -> float:
        """Wall-clock time of the samples that go with a pass."""
        kinds = self._direct, self.gathered
        return sum(kind.per_pass * kind.seconds for kind in kinds if kind)

    @property
    def gathering(self) -> GaussianPhotonField | None:
        """The field in which rays end, if light is gathered; :meth:`tensors` does not have it."""
        return self.gathered.field if self.gathered else None

    def _gathered_by(self, field: GaussianPhotonField, since: int) -> GatheredLight:
        seed = pass_seed(self.seed, since, Stream.GATHER_RAYS)
        return GatheredLight(self._points, field, seed, since)

    def sample(self) -> None:
        """Add the samples that go with the passes so far."""
        self._direct.sample(self.count)
        if self.gathered:
            self.gathered.sample(self.count)

    def _balance(self) -> None:
        """Choose how many samples to take per pass."""
        self.sample()
        rows = some_runs(len(self._source))
        which = self._asked(rows), self.gathered is None
        first, second = (self.photons.uncorrected(half, *which)[rows] for half in range(2))
        dr.flush_malloc_cache()
        sampled = [self._direct] if self._direct.lamps else []
        kinds = [*sampled, self.gathered] if self.gathered else sampled
        means = [(kind.mean(0)[rows], kind.mean(1)[rows]) for kind in kinds]
        balance(self.count, (first, second), kinds, means)

    def tensors(self) -> dict[str, np.ndarray]:
        """The photons and samples so far, for a file."""
        parts: Mapping[str, PhotonLight | SampledLight | None] = {
            "photons": self.photons,
            "direct": self._direct,
            "gathered": self.gathered,
        }
        found = {"count": np.array([self.count])}
        for name, part in parts.items():
            if part is not None:
                found |= {f"{name}/{key}": values for key, values in part.tensors().items()}
        return found

    def restore(
        self, tensors: Mapping[str, np.ndarray], field: GaussianPhotonField | None = None
    ) -> None:
        """Continue from :meth:`tensors` of a stream with the same arguments; ``field`` is the one
        of its :attr:`gathering`, if any."""

        def part(start: str) -> dict[str, np.ndarray]:
            return {k.removeprefix(start): v for k, v in tensors.items() if k.startswith(start)}

        self.photons.restore(part("photons/"), int(tensors["count"][0]))
        self._direct.restore(part("direct/"))
        if field is not None and (gathered := part("gathered/")):
            self.gathered = self._gathered_by(field, int(gathered["lit"][0]))
            self.gathered.restore(gathered)

    def mean(self, halves: tuple[Targets, Targets]) -> Targets:
        """The points, with the irradiance from all passes so far, given their :meth:`halves`."""
        even, odd = halves
        share = self.count // 2 / self.count
        return replace(
            even,
            irradiance=share * even.irradiance + (1 - share) * odd.irradiance,
            direct=share * even.direct + (1 - share) * odd.direct,
        )

    def halves(self, stride: int = 1) -> tuple[Targets, Targets]:
        """The points, with the irradiance from passes with even and with odd numbers.

        With a ``stride`` above 1, only every ``stride``-th point; these, too, are spread evenly.
        """
        self._rows = slice(None, None, stride)
        points = self._points.points
        self.sample()
        position, normal = (to_numpy(v)[self._rows] for v in (points.p, points.n))
        coarse = self.photons.coarse[self._rows]
        gathered = self._by_kernels(self.gathered is None)
        kernel = choose_kernels(position, normal, gathered, self.photons.radius)
        kernel = np.where(coarse, 0, kernel)
        self._kernel[self._rows] = kernel
        self.blur = np.where(coarse, 0, kernel_blur(kernel, gathered))
        light, found = pick(kernel, gathered), []
        if not self._by_photons and self.photons.volume is None:
            apart = light if self.gathered else pick(kernel, self._by_kernels(False))
            self.caustics = np.stack(apart)
        for half in range(2):
            direct = self._direct.mean(half)[self._rows]
            diffuse = self.gathered.mean(half)[self._rows] if self.gathered else np.float32(0)
            found.append(
                Targets(
                    position=position,
                    normal=normal,
                    irradiance=light[half] + diffuse + direct,
                    direct=direct,
                    reflectance=to_numpy(points.reflectance)[self._rows],
                    source=self._source[self._rows],
                )
            )
        return found[0], found[1]

    def _by_kernels(self, diffused: bool) -> list[tuple[np.ndarray, np.ndarray]]:
        """Irradiance of the points of the last call of :meth:`halves` by each half of the photons,
        for each kernel; ``diffused``: whether photons from diffuse surfaces count."""
        asked = self._asked(self._rows)
        halves = [self.photons.gather(half, asked, diffused) for half in range(2)]
        return [(a[self._rows], b[self._rows]) for a, b in zip(*halves, strict=True)]

    def by_group(self) -> np.ndarray:
        """Irradiance of the points of the last call of :meth:`halves` from each group of emitters,
        from all passes, (G, N, 3), with the radius chosen there for all light."""
        assert self._groups is not None
        found = self.photons.by_group(self._groups, self._asked(self._rows), self._kernel)
        if self._direct.lamps:
            found += self._direct.by_group(self._groups)
        return found[:, self._rows]

    def _asked(self, rows: slice | np.ndarray) -> np.ndarray:
        """Rows of all points as a mask, (N,) bool."""
        asked = np.zeros(len(self._source), bool)
        asked[rows] = True
        return asked
