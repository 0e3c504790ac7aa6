"""What the Blender add-on starts: `python -m gpf.commands.blender_engine REQUEST.json`.

The request names the scene, the camera, the size of the picture and the field's file. The field is
fitted if it is not there, or belongs to another scene. The picture's layers become arrays beside
the request. Each line on standard output that begins with ``gpf:`` has the share that is done, from
0 to 1, and words. An interrupt ends a fit; its best field is kept.
"""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from gpf.commands.scenes import find_scene
from gpf.core.errors import UserError, is_interrupt, no_lost_interrupts
from gpf.core.files import read_json
from gpf.core.runtime import choose_variant
from gpf.field.field import GaussianPhotonField
from gpf.field.io import load_field, save_field
from gpf.fitting.fit import fit
from gpf.fitting.progress import FitProgress
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
    tell(0, "reading the scene")
    scene = load_scene_file(find_scene(wanted["scene"])[0])
    path = Path(wanted["field"])
    field = _known_field(path, scene)
    if field is None:
        groups = LightGroups.parse("auto" if wanted["groups"] else "", scene)
        seconds = float(wanted["seconds"])

        def report(progress: FitProgress) -> None:
            quality = f", {progress.psnr:.1f} dB" if progress.psnr else ""
            share = min(progress.seconds / seconds, 1) * FITTED
            tell(share, f"fitting: {progress.passes} passes{quality}")

        state = path.with_suffix(".fit")
        field = fit(scene, seconds=seconds, callback=report, state=state, groups=groups)
        save_field(field, path)
        if interrupt.asked:
            return 130
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


def _known_field(path: Path, scene: Any) -> GaussianPhotonField | None:
    """The field in a file, or None if there is none or it is of another scene."""
    if not path.is_file():
        return None
    field = load_field(path)
    known = field.record.pop("fingerprint", None)
    return None if known and changed_parts(known, fingerprint(scene)) else field


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
