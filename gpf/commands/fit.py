"""`gpf fit`: a field for a scene file, with a progress bar and a preview that improves."""

from __future__ import annotations

import filecmp
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import mitsuba as mi
import numpy as np

from gpf.commands.cameras import file_beside
from gpf.commands.fit_options import FitOptions
from gpf.commands.overwriting import require_new
from gpf.commands.scenes import find_scene, title_of
from gpf.core.errors import UserError
from gpf.core.images import propose_exposure, write_png
from gpf.core.locks import sole_run
from gpf.core.partial import remove_leftovers
from gpf.core.progress import Bar, progress_bar, say
from gpf.core.runtime import choose_variant
from gpf.field.field import GaussianPhotonField
from gpf.field.io import save_field
from gpf.fitting.fit import FitProgress, fit
from gpf.fitting.state import Resume
from gpf.placement.cameras import ROWS
from gpf.scene.light_groups import LightGroups
from gpf.scene.load import load_scene_file
from gpf.scene.sensors import film_aspect, make_sensor, scene_cameras, views_of_sensors
from gpf.scene.transforms import read_sensors
from gpf.scene.untraceable import telling_untraceable

Existing = Literal["refuse", "continue", "overwrite"]
"""What to do with a field that exists: refuse to replace it, add photons to its fit, or replace it
by a new one."""

PREVIEW_ROWS, PREVIEW_SPP = 256, 16


def fit_scene_file(
    scene_name: str, out: Path, options: FitOptions, existing: Existing = "refuse"
) -> None:
    """Fit a field to the scene and write it to ``out``, with a preview picture beside it.

    Parameters
    ----------
    scene_name: as for :func:`gpf.commands.scenes.find_scene`.
    existing: what to do if ``out`` exists.
    """
    require_field_name(out)
    if existing != "continue":
        require_new(out, existing == "overwrite", "add photons with --continue")
    choose_variant("auto")
    path, trained = find_scene(scene_name)
    scene = load_scene_file(path)
    scene.set_id(title_of(scene_name))
    groups, views = LightGroups.parse(options.groups, scene), options.views
    if trained is not None:
        views = views or trained / "views.yaml"
    views = file_beside(path, views)
    sensors, exposure = (None, None) if views is None else read_sensors(views, ROWS)
    say("cameras: placed around the scene's own" if views is None else f"cameras: from {views}")
    preview, state = out.with_suffix(".png"), out.with_suffix(".fit")
    with (
        sole_run(out),
        telling_untraceable(str(path)),
        progress_bar(f"{path.stem}: preparing", 1) as bar,
    ):
        remove_leftovers(out.parent)
        resume: Resume = "never" if is_finished(state, out) else "if possible"
        field = fit(
            scene,
            sensors,
            seconds=options.seconds,
            target_psnr=options.target_psnr,
            passes=options.passes,
            seed=options.seed,
            callback=_Display(bar, path.stem, scene, _preview_sensor(scene, sensors), preview),
            state=state,
            groups=groups,
            exposure=exposure,
            resume="always" if existing == "continue" else resume,
        )
        save_field(field, out)
    record = field.record
    say(f"{out}: {describe_fit(record)}; preview: {preview}")
    used = sum(file.stat().st_size for file in state.iterdir())
    say(f"{state}: {used / 1e6:.0f} MB, to add photons later with --continue; else delete it.")


def describe_fit(record: Mapping[str, Any]) -> str:
    """Passes and estimated PSNR of a fit, and those of the last field but one, if there was one, to
    show what the last part of the time was worth."""
    *before, (passes, psnr) = record["fields"]
    text = f"{passes} passes, estimated PSNR {psnr:.1f} dB"
    if not before:
        return text
    earlier = "from photons alone" if before[-1][0] == passes else f"after {before[-1][0]}"
    return f"{text} ({earlier}: {before[-1][1]:.1f} dB)"


def require_field_name(out: Path) -> None:
    """Raise a :class:`UserError` unless this can be the name of a field: the preview and the state,
    beside it, have the same name with other endings."""
    if out.suffix != ".safetensors":
        raise UserError(
            str(out), "is not the name of a field", "Give a name that ends in .safetensors."
        )


def is_finished(state: Path, out: Path) -> bool:
    """Whether the fit with this state has written its field; False without a state.

    The state then has the same field. File times would be less reliable: clocks jump.
    """
    fields = state.glob("field-*.safetensors") if out.exists() else ()
    return any(filecmp.cmp(file, out, shallow=False) for file in fields)


def _preview_sensor(scene: mi.Scene, sensors: list[mi.Sensor] | None) -> mi.Sensor | None:
    """The scene's own camera with a small film, or else the first of the sensors, if any."""
    own = views_of_sensors(scene)
    if not own:
        return sensors[0] if sensors else None
    aspect = film_aspect(scene_cameras(scene)[0])
    return make_sensor(own[0], max(1, round(PREVIEW_ROWS * aspect)), PREVIEW_ROWS)


class _Display:
    """Shows the progress of a fit in the bar, and writes the preview after each evaluation."""

    def __init__(
        self, bar: Bar, title: str, scene: mi.Scene, sensor: mi.Sensor | None, preview: Path
    ) -> None:
        self.bar, self.title, self.preview = bar, title, preview
        self.scene, self.sensor = scene, sensor
        self.integrator = mi.load_dict({"type": "gpf"})
        self.called = False

    def __call__(self, progress: FitProgress) -> None:
        """Show the state of the fit."""
        if not self.called and progress.passes > 1:
            say(f"{self.title}: continuing after {progress.passes - 1} passes")
        self.called = True
        quality = "" if progress.psnr is None else f", {progress.psnr:.1f} dB"
        self.bar.describe(f"{self.title}: passes and steps{quality}")
        self.bar(progress.passes + progress.steps, progress.all_passes + progress.all_steps)
        if progress.field is not None:
            self._write_preview(progress.field)

    def _write_preview(self, field: GaussianPhotonField) -> None:
        self.integrator.field = field
        image = mi.render(
            self.scene, sensor=self.sensor, integrator=self.integrator, spp=PREVIEW_SPP
        )
        radiance = np.array(image)[..., :3]
        write_png(self.preview, radiance, propose_exposure(radiance))
