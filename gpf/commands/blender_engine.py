"""What the Blender add-on starts: `python -m gpf.commands.blender_engine REQUEST.json`.

The request names the scene, the camera, the size of the picture and the field's file. The field is
fitted if it is not there, or belongs to another scene or other groups of lights, and fitted further
if it had less time than is asked for. The picture's layers become arrays beside the request. Each
line on standard output that begins with ``gpf:`` has the share that is done, from 0 to 1, and
words. An interrupt ends a fit; its best field is kept.
"""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from types import FrameType
from typing import Any

import mitsuba as mi
import numpy as np

from gpf.blender.conversion import convert
from gpf.core.errors import UserError, is_interrupt, no_lost_interrupts
from gpf.core.files import read_json
from gpf.core.runtime import choose_variant
from gpf.field.field import GaussianPhotonField
from gpf.field.io import load_field, save_field
from gpf.fitting.fit import fit
from gpf.fitting.progress import FitProgress
from gpf.fitting.state import Resume
from gpf.rendering.denoiser import available
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings
from gpf.scene.fingerprint import changed_parts, fingerprint
from gpf.scene.light_groups import LightGroups
from gpf.scene.load import load_scene_file
from gpf.scene.views import View

LAYERS = ("depth", "normal", "albedo", "error")

FITTED = 0.8
"""Share of the work that a fit is."""


class _Interrupt:
    """Whether the user has asked to stop; the first time, a fit ends with what it has."""

    def __init__(self) -> None:
        self.asked = False
        signal.signal(signal.SIGINT, self._note)

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.asked = True
        raise KeyboardInterrupt


def render_request(request: Path, interrupt: _Interrupt) -> int:
    """Answer a request; the exit code: 0, or 130 if the user stopped it."""
    wanted: dict[str, Any] = read_json(request)
    choose_variant("auto")
    copy, folder = Path(wanted["scene"]), request.with_name("converted")
    scene = load_scene_file(convert(copy, folder, lambda what: tell(0, what)).xml)
    path, groups = (
        Path(wanted["field"]),
        LightGroups.parse("auto" if wanted["groups"] else "", scene),
    )
    field, fitted = _known_field(path, scene, groups)
    seconds = float(wanted["seconds"])
    if fitted < seconds:
        field, spent = _fit(scene, path.with_suffix(".fit"), groups, seconds, fitted)
        field.record["fitted"] = spent if interrupt.asked else seconds
        save_field(field, path)
        if interrupt.asked:
            return 130
    assert field is not None
    tell(FITTED, "rendering")
    settings = RenderSettings(spp=int(wanted["samples"]), denoise=available())
    renderer = FieldRenderer.make(scene, field, settings, LAYERS)
    layers = renderer.render(View(name="picture", **wanted["view"]), tuple(wanted["size"]), 0)
    for name, pixels in layers.items():
        np.save(request.with_name(f"{name}.npy"), pixels.astype(np.float32))
    tell(1, "done")
    return 0


def tell(share: float, words: str) -> None:
    """Say how far the work is."""
    print(f"gpf: {share:.3f} {words}", flush=True)


def _known_field(
    path: Path, scene: mi.Scene, groups: LightGroups | None
) -> tuple[GaussianPhotonField | None, float]:
    """The field in a file, and for how many seconds it was fitted; None and 0 if there is none, or
    it is of another scene or other groups."""
    if path.is_file():
        field = load_field(path)
        known = field.record.pop("fingerprint", None)
        own = field.lights.groups if field.lights else None
        if own == groups and not (known and changed_parts(known, fingerprint(scene))):
            return field, float(field.record.get("fitted", 0))
    return None, 0.0


def _fit(
    scene: mi.Scene, state: Path, groups: LightGroups | None, seconds: float, fitted: float
) -> tuple[GaussianPhotonField, float]:
    """Fit a field, or go on for the rest of the time; for how many seconds it was fitted in all.

    ``fitted``: for how many it was before.
    """

    def report(progress: FitProgress) -> None:
        quality = f", {progress.psnr:.1f} dB" if progress.psnr else ""
        share = min((fitted + progress.seconds) / seconds, 1) * FITTED
        tell(share, f"fitting: {progress.passes} passes{quality}")

    resume: Resume = "always" if fitted else "if possible"
    how: dict[str, Any] = {"callback": report, "state": state, "groups": groups}
    try:
        field = fit(scene, seconds=seconds - fitted, resume=resume, **how)
    except UserError:
        if not fitted:
            raise
        fitted = 0.0  # the camera has moved since, or the photons are gone
        field = fit(scene, seconds=seconds, resume="never", **how)
    return field, fitted + field.record["seconds"]


def main(request: Path) -> int:
    """The program; its exit code."""
    interrupt = _Interrupt()
    with no_lost_interrupts():
        try:
            return render_request(request, interrupt)
        except UserError as error:
            print(error, file=sys.stderr)
            return error.exit_code
        except BaseException as error:
            if interrupt.asked or is_interrupt(error):
                return 130
            raise


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
