"""Pictures on many machines: each task of a Ray cluster renders one view.

A picture depends only on its view, its seed and the settings, so a cluster gives the same bits as
one machine. A task brings the scene and the field; a worker needs only the same version of this
package.
"""

from __future__ import annotations

import io
import os
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import drjit as dr
import numpy as np

from gpf.core.cluster import ClusterChoice, cores_of_smallest_machine, task_result, wait_for_tasks
from gpf.core.runtime import choose_variant
from gpf.field.io import load_field
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.lights import set_lights
from gpf.rendering.settings import RenderSettings
from gpf.scene.load import load_scene_file
from gpf.scene.views import View
from gpf.scene.xml import read_scene_xml

FIELD = "field.safetensors"


@dataclass(frozen=True)
class RenderJob:
    """All that a worker needs to render a view.

    Attributes
    ----------
    scene: a zip archive of the scene's files.
    scene_file: the scene file's name in the archive.
    parameters: of the scene file.
    field: the contents of the field's file.
    size: width and height, pixels.
    seconds: time for a picture, in place of the samples of the settings.
    lights: levels of groups of emitters.
    """

    scene: bytes
    scene_file: str
    parameters: tuple[tuple[str, str], ...]
    field: bytes
    settings: RenderSettings
    aovs: tuple[str, ...]
    size: tuple[int, int]
    seconds: float | None
    lights: str = ""


def pack_scene(scene_file: Path, parameters: Mapping[str, str]) -> tuple[bytes, str]:
    """A zip archive of a scene file and all files that it refers to with these parameters, and the
    scene's name in it."""
    document = read_scene_xml(scene_file, parameters)
    files = [path.absolute() for path in (scene_file, *document.files())]
    files = [Path(os.path.normpath(path)) for path in files]
    root = Path(os.path.commonpath([path.parent for path in files]))
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in dict.fromkeys(files):
            archive.write(path, path.relative_to(root))
    return data.getvalue(), files[0].relative_to(root).as_posix()


def render_on_cluster(
    job: RenderJob, seeds: Mapping[str, int], views: list[View], address: str
) -> Iterator[tuple[View, dict[str, np.ndarray]]]:
    """The layers of views, in the order in which they finish; ``seeds`` has view names as keys.

    Raises
    ------
    UserError: there is no such cluster, or a worker raised one.
    """
    choice = ClusterChoice("--executor", address, "--cluster", os.cpu_count() or 1)
    ray = choice.connect()
    task = ray.remote(num_cpus=cores_of_smallest_machine(ray))(render_view)
    sent = ray.put(job)
    running = {task.remote(sent, view, seeds[view.name]): view for view in views}
    try:
        while running:
            for reference in wait_for_tasks(ray, running):
                view = running.pop(reference)
                yield view, task_result(ray, reference, f"view {view.name}")
    finally:
        for reference in running:
            ray.cancel(reference, force=True)


def render_view(job: RenderJob, view: View, seed: int) -> dict[str, np.ndarray]:
    """Render the layers of a view, on a worker."""
    return _open(job).render(view, job.size, seed, job.seconds)


@lru_cache(maxsize=1)
def _open(job: RenderJob) -> FieldRenderer:
    """The renderer of a job, made once per process."""
    choose_variant("auto")
    # At least two: with one, Mitsuba hangs when it reads an EXR file.
    dr.set_thread_count(max(2, os.cpu_count() or 1))
    with tempfile.TemporaryDirectory(prefix="gpf-worker-") as name:
        folder = Path(name)
        with zipfile.ZipFile(io.BytesIO(job.scene)) as archive:
            archive.extractall(folder / "scene")
        (folder / FIELD).write_bytes(job.field)
        scene = load_scene_file(folder / "scene" / job.scene_file, parameters=dict(job.parameters))
        field = load_field(folder / FIELD)
        if job.lights:
            set_lights(scene, field, job.lights)
        return FieldRenderer.make(scene, field, job.settings, job.aovs)
