"""``gpf.fit``: from a scene to a field, without any choices to make."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import mitsuba as mi

from gpf.core.errors import UserError, is_interrupt
from gpf.field.field import GaussianPhotonField
from gpf.fitting import opening
from gpf.fitting.field_maker import FieldMaker
from gpf.fitting.field_series import TRAINING, FieldSeries
from gpf.fitting.goals import Goals, TimeBudget, require_seed
from gpf.fitting.progress import FitProgress, Reporter
from gpf.fitting.quality import QualityEstimate
from gpf.fitting.state import FitState, Resume, fit_identity
from gpf.placement.cameras import place_sensors
from gpf.scene.light_groups import LightGroups
from gpf.scene.solids import OVERLAP, overlapping_solids
from gpf.training.streaming import StreamSettings

# A field whose estimated PSNR is below this, or this far below SPPM with the same passes (dB), has
# failed.
POOR, FAR_BELOW = 15.0, 6.0
FAILED = (
    "This field failed: its images have an estimated PSNR of %.1f dB; SPPM with %s passes would "
    "reach %.1f dB. Look at an image rendered from it. Fit longer, or with cameras that look at "
    "what matters (views.yaml). If that does not help, look for a lamp of extreme brightness or "
    "colour, or for a floor far larger than the part that is to be seen."
)

STREAM = StreamSettings()

log = logging.getLogger(__name__)


def fit(
    scene: mi.Scene,
    sensors: Sequence[mi.Sensor] | None = None,
    *,
    seconds: float | None = None,
    target_psnr: float | None = None,
    passes: int | None = None,
    seed: int = 0,
    callback: Callable[[FitProgress], None] = lambda progress: None,
    state: Path | None = None,
    groups: LightGroups | None = None,
    exposure: float | None = None,
    resume: Resume = "if possible",
) -> GaussianPhotonField:
    """Fit a field to a scene.

    The fit stops when the first of its goals is reached or, without any goal, after
    :data:`gpf.fitting.goals.DEFAULT_PASSES` passes. It always completes a field from nine passes,
    or from two if fewer are asked for, however long that takes. Interrupted by Ctrl-C, it returns
    the best field so far. The same seed and passes give the same bits on the same machine.

    Parameters
    ----------
    sensors: at least one camera that looks at what the field is for; by default cameras are placed
        around the scene's own, as ``gpf scene import`` does.
    seconds: wall-clock time for the whole fit.
    target_psnr: estimated PSNR of images against an SPPM reference with 1000 passes, dB.
    passes: photon passes.
    callback: called after each pass and each optimiser step.
    state: a folder in which the fit keeps its photons, some 100 MB. A later fit of the same scene
        with the same cameras, groups and seed continues with all of them.
    groups: groups of emitters whose light the field keeps apart (``field.lights``), so that each
        can be dimmed later.
    exposure: exposure of the images whose PSNR is estimated; by default one that suits them
        (:func:`gpf.core.images.propose_exposure`).
    resume: whether to continue from ``state``. ``always``: it is an error if the folder has no
        photons, or those of another fit; ``never``: replace what is there.

    Raises
    ------
    UserError: a goal is not above 0; the seed is not from 0 to 2³¹ - 1; the scene has no emitter or
        no diffuse surface, or a material that is not supported; there is no camera, or the cameras
        see no diffuse surface, or no light reaches those that they see; the light is not finite; or
        the fit cannot resume.
    """
    goals, time = Goals.asked(seconds, target_psnr, passes), TimeBudget(seconds)
    require_seed(seed)
    if resume == "always" and state is None:
        raise UserError("resume", "needs a state folder", "Give the folder with the photons.")
    origin = opening.examine(scene)
    for pair in overlapping_solids(scene):
        log.warning(OVERLAP, *pair)
    # Sorted, so that the field does not depend on their order.
    cameras = sorted(place_sensors(scene) if sensors is None else sensors, key=str)
    with time:
        settings = STREAM.model_copy(update={"seed": seed})
        start = opening.Opening.look(scene, cameras, settings, groups, opening.Shared())
        look = start.passes, start.sampled, seed, start.source
        quality = QualityEstimate(scene, cameras, *look, exposure=exposure)
        maker = FieldMaker(start.stream, start.query, groups, TRAINING)
        run = FieldSeries(goals, time, Reporter(callback), origin, maker, quality)
        try:
            if state is not None:
                run.resume(FitState(Path(state), _identity(run, cameras)), resume)
            run.run()
        except BaseException as error:
            if run.best.field is None or not is_interrupt(error):
                raise
            log.warning("Interrupted: this is the field after %s passes.", run.best.passes)
    field = run.result()
    psnr, sppm = field.record["estimated_psnr"], run.quality.sppm_psnr(field, run.best.passes)
    if psnr < POOR or psnr < sppm - FAR_BELOW:
        log.warning(FAILED, psnr, run.best.passes, sppm)
    return field


def _identity(run: FieldSeries, cameras: Sequence[mi.Sensor]) -> dict[str, Any]:
    """What saved photons belong to."""
    stream, groups = run.stream, run.maker.groups
    parts = opening.REGION, STREAM, stream.photons.settings, run.maker.query(1.0)
    settings = {"settings": [part.model_dump() for part in parts], "seed": stream.seed}
    if groups is not None:
        settings["groups"] = [groups.names, groups.members]
    return fit_identity(stream.scene, cameras, settings)
