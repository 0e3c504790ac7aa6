"""What a fit knows of its scene before the first photon that it keeps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any, Literal

import mitsuba as mi

from gpf.core.errors import UserError
from gpf.field.settings import Direct, FieldSettings, sampled_lamps
from gpf.guiding.emission_plan import EmissionPlan, VisibleRegionSettings
from gpf.photons.emission import Source
from gpf.scene.bounds import scene_bounds
from gpf.scene.fingerprint import fingerprint
from gpf.scene.inventory import check_scene
from gpf.scene.lamps import Lamps
from gpf.scene.light_groups import LightGroups
from gpf.scene.media import Media
from gpf.sppm.passes import PassSettings, suit_scene
from gpf.sppm.reference import ReferenceSettings
from gpf.training.direct_light import choose_direct
from gpf.training.stream_points import stream_points
from gpf.training.streaming import PhotonStream, StreamSettings
from gpf.training.volume_light import VolumeLight

REGION = VisibleRegionSettings(rays=131_072, pilot_paths=131_072)


def examine(scene: mi.Scene) -> dict[str, Any]:
    """What the record of a field says of its scene: its name, if it has one, its fingerprint, and
    the time, UTC, to the minute.

    Raises
    ------
    UserError: as :func:`gpf.scene.inventory.check_scene`.
    """
    check_scene(scene)
    # First: they evaluate parameters of the scene, and earlier kernels could not be reused.
    scene_bounds(scene)
    now = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
    return {"name": scene.id(), "date": now, "fingerprint": fingerprint(scene)}


def plan_emission(
    scene: mi.Scene, cameras: Sequence[mi.Sensor], seed: int, before: EmissionPlan | None = None
) -> tuple[EmissionPlan, EmissionPlan]:
    """The emission of photons in a scene, and the plan to give as ``before`` with the next frame:
    the one that it comes from."""
    settings = REGION.model_copy(update={"seed": seed})
    plan = None if before is None else before.again(scene, cameras, settings)
    if before is None or plan is None:
        plan = before = EmissionPlan.make(scene, cameras, settings)
    # Without its region, which would keep the frame's points.
    return plan, replace(before, region=None)


@dataclass(frozen=True)
class Shared:
    """What the frames of an animation have in common, so that errors stay the same.

    Attributes
    ----------
    radius: radius of the first pass of a reference, world units.
    plan: of the frame in which it was made, or None. In the others, its source emits the photons as
        long as it serves them (:meth:`EmissionPlan.again`).
    """

    radius: float | Literal["auto"] = "auto"
    plan: EmissionPlan | None = None


@dataclass(frozen=True)
class Opening:
    """What a fit begins with.

    Attributes
    ----------
    stream: the stream of photons, without passes.
    direct: source of the direct light of its fields.
    passes: settings of the passes of a reference.
    source: emits the photons.
    sampled: the emitters whose direct light the fields do not store.
    shared: for other frames.
    """

    stream: PhotonStream
    direct: Direct
    passes: PassSettings
    source: Source
    sampled: Lamps
    shared: Shared

    @classmethod
    def look(
        cls,
        scene: mi.Scene,
        cameras: Sequence[mi.Sensor],
        settings: StreamSettings,
        groups: LightGroups | None,
        shared: Shared,
    ) -> Opening:
        """Look around in a scene.

        Parameters
        ----------
        cameras: they see what the fields are for.
        groups: groups of emitters whose light is kept apart.
        shared: what earlier frames have left.

        Raises
        ------
        UserError: there is no camera; or what :func:`gpf.fitting.fit.fit` raises of a scene.
        """
        if not cameras:
            raise UserError("sensors", "is empty", "Give a camera, or leave it out.")
        seed = settings.seed
        plan, made = plan_emission(scene, cameras, seed, shared.plan)
        reference = ReferenceSettings(seed=seed, initial_radius=shared.radius)
        passes = reference.measure(scene, cameras, plan)
        direct = choose_direct(scene, passes)
        sampled = sampled_lamps(scene, direct)
        own = settings.passes_like(passes)
        photons = plan.collect(scene, own.photons_per_pass, seed, own.rr_depth)
        named = {f"{k}": camera for k, camera in enumerate(cameras)}
        points = stream_points(scene, named, plan, passes, settings, photons)
        stored = None if direct == "field" else sampled.others()
        volume = None
        if Media(scene).there:
            paths = suit_scene(own, scene).path_settings(plan.source)
            volume = VolumeLight(scene, named, paths, own.alpha, seed, groups)
        stream = PhotonStream(scene, own, points, seed, plan.source, stored, groups, volume)
        shared = Shared(passes.initial_radius, made)
        return cls(stream, direct, passes, plan.source, sampled, shared)

    def query(self, radius: float) -> FieldSettings:
        """The settings of a field with this search radius."""
        return FieldSettings(search_radius=radius, direct=self.direct)
