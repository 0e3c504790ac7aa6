"""What `train.supervision: streaming` learns from: passes that come in during the training."""

from __future__ import annotations

from dataclasses import replace

from gpf.streaming import PhotonStream, StreamSettings
from gpf.structs import Photons
from gpf.supervision import SURFACE
from stages.groups import Job, share_of_pixels, target_points
from stages.most_gaussians import most_gaussians
from stages.passes import SURFACES
from stages.workspace import Workspace


def open_stream(work: Workspace) -> tuple[PhotonStream, Photons]:
    """Points in the training views and on the surfaces, what the first passes bring there, and
    photons for Gaussians."""
    job, section = Job.open(work), work.params.stream
    settings = replace(
        job.settings,
        alpha=section.alpha,
        initial_radius=section.radius * job.settings.initial_radius,
    )
    views = work.views.train
    share = share_of_pixels(work, section.view_points)
    wanted = "views" if work.params.field.stores == "radiance" else work.params.train.points
    surfaces = 0 if wanted == "views" else section.surface_points
    paths = job.lookout.paths_for_gaussians(most_gaussians(work.params.field.gaussians))
    photons = job.collect(max(paths, 2 * settings.photons_per_pass), section.seed)
    seen = [] if wanted == "surface" else views
    sets = target_points(job, seen, share, surfaces, section.seed, photons)
    sources = {view.name: k for k, view in enumerate(views)} | {SURFACES: SURFACE}
    points = {sources[name]: found for name, found in sets.items()}
    stream = PhotonStream(job.scene, settings, points, section.seed, job.lookout.source)
    stream.advance(stream_settings(work).rounds()[0])
    return stream, photons


def stream_settings(work: Workspace) -> StreamSettings:
    """The library's settings from the section of params.yaml."""
    section = work.params.stream
    return StreamSettings(section.passes, section.first, section.growth)
