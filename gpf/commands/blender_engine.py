"""What the Blender add-on starts: `python -m gpf.commands.blender_engine REQUEST.json`.

The request names the scene, the size and the region of the picture, and the file of the field,
which is fitted if it is not there, or belongs to another scene or other groups of lights, and
fitted further if it had less time than is asked for. The picture's layers become arrays beside the
request. Each line on standard output that begins with ``gpf:`` has the share that is done, from 0
to 1, and words. An interrupt ends a fit; its best field is kept.
"""

from __future__ import annotations

import math
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
from gpf.scene.pinhole import make_pinhole
from gpf.scene.sensors import views_of_sensors
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
    field = _fit(scene, wanted, interrupt)
    if interrupt.asked:
        return 130
    tell(FITTED, "rendering")
    settings = RenderSettings(spp=int(wanted["samples"]), denoise=available())
    renderer = FieldRenderer.make(scene, field, settings, LAYERS)
    view, size = _crop(views_of_sensors(scene)[0], wanted["size"], wanted["region"])
    for name, pixels in renderer.render(view, size, 0).items():
        np.save(request.with_name(f"{name}.npy"), pixels.astype(np.float32))
    tell(1, "done")
    return 0


def tell(share: float, words: str) -> None:
    """Say how far the work is."""
    print(f"gpf: {share:.3f} {words}", flush=True)


def _fit(scene: mi.Scene, wanted: dict[str, Any], interrupt: _Interrupt) -> GaussianPhotonField:
    """The field in the file, if it is of this scene and these groups and was fitted for the time
    that is asked for; else a field that is fitted now, from that one if its photons can be used."""
    groups = LightGroups.parse("auto" if wanted["groups"] else "", scene)
    file, seconds, fitted = Path(wanted["field"]), float(wanted["seconds"]), 0.0
    if file.is_file():
        field = load_field(file)
        known, own = field.record.pop("fingerprint", None), field.lights and field.lights.groups
        if own == groups and not (known and changed_parts(known, fingerprint(scene))):
            fitted = float(field.record.get("fitted", 0))
    if fitted >= seconds:
        return field

    def report(progress: FitProgress) -> None:
        quality = f", {progress.psnr:.1f} dB" if progress.psnr else ""
        share = min((fitted + progress.seconds) / seconds, 1) * FITTED
        tell(share, f"fitting: {progress.passes} passes{quality}")

    how: dict[str, Any] = {"callback": report, "state": file.with_suffix(".fit"), "groups": groups}
    try:
        resume: Resume = "always" if fitted else "if possible"
        field = fit(scene, seconds=seconds - fitted, resume=resume, **how)
    except UserError:
        if not fitted:
            raise
        fitted = 0.0  # the camera has moved since, or the photons are gone
        field = fit(scene, seconds=seconds, resume="never", **how)
    spent = fitted + field.record["seconds"]
    field.record["fitted"] = spent if interrupt.asked else seconds
    save_field(field, file)
    return field


def _crop(view: View, size: list[int], region: list[list[int]]) -> tuple[View, tuple[int, int]]:
    """The camera for a region of a picture, and the region's size.

    ``region``: the first column and row from the upper left, and those after the last.
    """
    whole = make_pinhole(view, (size[0], size[1]))
    first, last = np.array(region)
    width, height = (int(n) for n in last - first)
    shift = 0.5 - (np.array(whole.centre) - first) / (last - first)
    fov = math.degrees(2 * math.atan(width / 2 / whole.focal))
    changed = {"fov": fov, "fov_axis": "x", "shift": tuple(shift.tolist())}
    return view.model_copy(update=changed), (width, height)


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
