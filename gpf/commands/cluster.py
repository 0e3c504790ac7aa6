"""Pictures on many machines: each task of a Ray cluster renders one view.

A picture depends only on its view, its seed and the settings, so a cluster gives the same bits as
one machine.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np

from gpf.commands.workers import SentScenes, begin_work, unpack_field
from gpf.core.cluster import ClusterChoice, cores_of_smallest_machine, run_tasks
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.lights import set_lights
from gpf.rendering.settings import RenderSettings
from gpf.scene.load import load_frame
from gpf.scene.untraceable import telling_untraceable
from gpf.scene.views import View

Picture = TypeVar("Picture")


@dataclass(frozen=True)
class RenderJob:
    """All that a worker needs to render views of a scene.

    Attributes
    ----------
    scenes: the scene.
    field: the contents of the field's file.
    size: width and height, pixels.
    seconds: time for a picture, in place of the samples of the settings.
    lights: levels of groups of emitters.
    """

    scenes: SentScenes
    field: bytes
    settings: RenderSettings
    aovs: tuple[str, ...]
    size: tuple[int, int]
    seconds: float | None
    lights: str = ""


def render_on_cluster(
    choice: ClusterChoice, pictures: Iterable[tuple[Picture, RenderJob, View, int]]
) -> Iterator[tuple[Picture, dict[str, np.ndarray]]]:
    """The layers of pictures, in the order in which they finish.

    Parameters
    ----------
    pictures: each with its job, view and seed; those of a job follow each other. Few are taken
        ahead.

    Raises
    ------
    UserError: there is no such cluster, or a worker raised one.
    """
    ray = choice.connect()
    cores = cores_of_smallest_machine(ray)
    task = ray.remote(num_cpus=cores)(render_view)

    def submitted() -> Iterator[tuple[Picture, Any]]:
        last, sent = None, None
        for picture, job, view, seed in pictures:
            if job is not last:
                last, sent = job, ray.put(job)
            yield picture, task.remote(sent, view, seed)

    yield from run_tasks(ray, cores, submitted())


def render_view(job: RenderJob, view: View, seed: int) -> dict[str, np.ndarray]:
    """Render the layers of a view, on a worker."""
    with telling_untraceable(str(job.scenes.root / job.scenes.frames[0].file)):
        return _open(job).render(view, job.size, seed, job.seconds)


@lru_cache(maxsize=1)
def _open(job: RenderJob) -> FieldRenderer:
    """The renderer of a job, made once per process."""
    begin_work()
    with job.scenes.unpacked() as (frame,):
        scene, field = load_frame(frame), unpack_field(job.field)
        if job.lights:
            set_lights(scene, field, job.lights)
        return FieldRenderer.make(scene, field, job.settings, job.aovs)
