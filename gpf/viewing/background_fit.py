"""A fit in a process of its own, which pauses while the viewer needs the cores.

On its standard output, the process has nothing but one JSON object per line: its progress, and
whether there is a new field to show.
"""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gpf.core.errors import UserError
from gpf.core.files import write_atomically

PASSES = 1000
"""Photon passes of the whole fit: as many as a reference has."""

# Time between reports of progress.
_REPORT_SECONDS = 0.25


@dataclass(frozen=True)
class FitStatus:
    """Progress of the fit.

    Attributes
    ----------
    psnr: estimated PSNR of images from the field, dB; None before the second complete field,
        because the first is a draft.
    fields: number of fields so far; each one replaces the file.
    ended: whether the process has ended.
    error: why it failed; empty if it did not.
    """

    passes: int = 0
    all_passes: int = PASSES
    psnr: float | None = None
    fields: int = 0
    ended: bool = False
    error: str = ""


class BackgroundFit:
    """Starts a fit of a scene file, and follows its progress.

    Parameters
    ----------
    out: where the field is written when the fit ends or :meth:`close` is called; beside it is a
        folder with the photons, from which a later fit continues.
    views: a file with the cameras that the field is for; None to place some.
    folder: folder for the newest field.
    groups: groups of emitters whose light is kept apart (:meth:`LightGroups.parse`).
    """

    def __init__(
        self, scene_file: Path, out: Path, views: Path | None, folder: Path, groups: str = ""
    ) -> None:
        self.out, self.live = out, folder / "live.safetensors"
        self.status = FitStatus()
        self._paused = self._closing = False
        self._errors = (folder / "errors.txt").open("wb")
        command = [sys.executable, "-m", "gpf.viewing.background_fit"]
        command += [str(os.getpid()), str(scene_file), str(out), str(self.live)]
        command += [str(views or ""), groups]
        # In a session of its own: Ctrl-C is for the viewer, which ends the fit.
        self._process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=self._errors, start_new_session=True
        )
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def pause(self, paused: bool) -> None:
        """Pause the process at once, or let it continue."""
        if paused != self._paused and self._process.poll() is None:
            # Not os.kill: the process may have ended meanwhile.
            self._process.send_signal(signal.SIGSTOP if paused else signal.SIGCONT)
            self._paused = paused

    def close(self) -> bool:
        """End the fit and keep its newest field; return whether there is one."""
        self._closing = True
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        self._thread.join(1)
        self._errors.close()
        if not self.live.exists():
            return self.status.ended and not self.status.error and self.out.exists()
        write_atomically(self.out, lambda part: shutil.copyfile(self.live, part))
        return True

    def _listen(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as reports:
            for line in reports:
                facts: dict[str, Any] = json.loads(line)
                fields = self.status.fields + bool(facts.pop("field", False))
                self.status = FitStatus(**facts, fields=fields)
        code = self._process.wait()
        error = ""
        if code < 0 and not self._closing:
            error = f"{signal.Signals(-code).name} ended it, perhaps for lack of memory"
        elif code > 0:
            text = Path(self._errors.name).read_text(errors="replace").strip()
            error = text.splitlines()[-1] if text else f"the fit ended with exit code {code}"
        self.status = replace(self.status, ended=True, error=error)


def main(
    parent: int, scene_file: Path, out: Path, live: Path, views: Path | None, groups: str
) -> None:
    """Fit a field for the process ``parent``, write each field that is worth showing to ``live``,
    and the last to ``out``."""
    _end_with(parent)
    from gpf.core.runtime import choose_variant
    from gpf.field.io import save_field
    from gpf.fitting.fit import FitProgress, fit
    from gpf.placement.cameras import ROWS
    from gpf.scene.light_groups import LightGroups
    from gpf.scene.load import load_scene_file
    from gpf.scene.transforms import read_sensors
    from gpf.scene.untraceable import telling_untraceable

    # Mitsuba prints its warnings, too; the viewer has printed them.
    reports = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    choose_variant("auto")
    scene = load_scene_file(scene_file)
    sensors, exposure = (None, None) if views is None else read_sensors(views, ROWS)
    told, drafted = 0.0, False

    def tell(passes: int, psnr: float | None, field: bool) -> None:
        facts = {"passes": passes, "all_passes": PASSES, "psnr": psnr, "field": field}
        print(json.dumps(facts), file=reports, flush=True)

    def report(progress: FitProgress) -> None:
        nonlocal told, drafted
        # A field in training may be worse than the complete one before it.
        complete = progress.steps == progress.all_steps
        show = progress.field is not None and (complete or not drafted)
        drafted |= show and complete
        if show:
            assert progress.field is not None
            save_field(progress.field, live)
        if show or time.monotonic() - told > _REPORT_SECONDS:
            told = time.monotonic()
            tell(progress.passes, progress.psnr, show)

    with telling_untraceable(str(scene_file)):
        field = fit(
            scene,
            sensors,
            passes=PASSES,
            callback=report,
            state=out.with_suffix(".fit"),
            groups=LightGroups.parse(groups, scene),
            exposure=exposure,
        )
    save_field(field, live)
    tell(PASSES, field.record["estimated_psnr"], True)


def _end_with(parent: int) -> None:
    """Have the kernel kill this process when the viewer ends, even while it is paused.

    Only Linux can do this. Elsewhere a thread watches the viewer, and is paused with the process.
    """
    if sys.platform == "linux":
        set_death_signal = 1
        ctypes.CDLL(None).prctl(set_death_signal, signal.SIGKILL)
    else:
        threading.Thread(target=_kill_after, args=(parent,), daemon=True).start()
    if os.getppid() != parent:  # it has ended already
        sys.exit(1)


def _kill_after(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_REPORT_SECONDS)
    os.kill(os.getpid(), signal.SIGKILL)


if __name__ == "__main__":
    try:
        viewer, *paths, cameras, lights = sys.argv[1:]
        views_file = Path(cameras) if cameras else None
        main(int(viewer), Path(paths[0]), Path(paths[1]), Path(paths[2]), views_file, lights)
    except UserError as problem:
        print(problem, file=sys.stderr)
        sys.exit(problem.exit_code)
