"""The options of a row, one model per system.

A row has the method's name and a ``system``, which selects the model for its other keys.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, Literal

from pydantic import Field

from gpf.core.settings import Count, Positive, Settings


class _Options(Settings):
    """Options that all systems have.

    ``scenes``: the scenes that the method is run for; empty for all scenes.
    """

    scenes: tuple[str, ...] = ()

    @property
    @abstractmethod
    def title(self) -> str:
        """The method's name in tables and figures."""

    @property
    def training_views(self) -> int:
        """The number of training views, with references, that the system gets."""
        return 0

    @property
    def learns_from_targets(self) -> bool:
        """Whether the system learns from the same targets as the field."""
        return False

    @property
    def learns(self) -> bool:
        """Whether the system learns something that should be kept between runs."""
        return self.training_views > 0 or self.learns_from_targets

    @property
    def waits_for_field(self) -> bool:
        """Whether the system needs the field's time per view, or the field itself."""
        return self.renders_field

    @property
    def renders_field(self) -> bool:
        """Whether the system renders the trained field."""
        return False

    @property
    def lists(self) -> tuple[str, ...]:
        """The lists of ``methods`` that may contain the row.

        ``equal_time`` waits for the field's timings, ``learned`` for references and targets,
        ``classical`` for neither.
        """
        if self.waits_for_field:
            return ("equal_time",)
        if self.learns:
            return ("learned",)
        return ("classical", "learned")


class _Learned(_Options):
    """A system that learns a scene from images."""

    views: Count = 3

    @property
    def training_views(self) -> int:
        """The number of training views, with references, that the system gets."""
        return self.views


class _Sampled(_Options):
    """A system whose error goes to zero as the number of samples per pixel grows.

    ``spp: equal_time`` takes as many samples as fit into the field's time per view.
    """

    spp: Count | Literal["equal_time"] = 50

    @property
    def samples(self) -> str:
        """The number of samples per pixel, in words for titles."""
        return "equal time" if self.waits_for_field else f"{self.spp} spp"

    @property
    def waits_for_field(self) -> bool:
        """Whether the system needs the field's time per view."""
        return self.spp == "equal_time"


class _Timed(_Options):
    """A renderer that is given a time per view, in seconds, or ``equal_time``: the field's."""

    seconds: Positive | Literal["equal_time"] = 60.0

    @property
    def effort(self) -> str:
        """The time per view, in words for titles."""
        return "equal time" if self.seconds == "equal_time" else f"{self.seconds:g} s"

    @property
    def waits_for_field(self) -> bool:
        """Whether the system needs the field's time per view."""
        return self.seconds == "equal_time"


class PathTracerOptions(_Sampled):
    """Mitsuba's ``path``."""

    system: Literal["path_tracer"]

    @property
    def title(self) -> str:
        """The method's name in tables and figures."""
        return f"Path tracer, {self.samples}"


class ParticleTracerOptions(_Sampled):
    """Mitsuba's ``ptracer``."""

    system: Literal["particle_tracer"]
    spp: Count | Literal["equal_time"] = 64

    @property
    def title(self) -> str:
        """The method's name in tables and figures."""
        return f"Particle tracer, {self.samples}"


class SppmOptions(_Options):
    """Stochastic progressive photon mapping with few passes (:mod:`gpf.sppm.passes`)."""

    system: Literal["sppm"]
    passes: Count = 3
    photons_per_pass: Count = 100_000

    @property
    def title(self) -> str:
        """The method's name in tables and figures."""
        return f"SPPM, {self.passes} passes"


class DenoisedOptions(_Sampled):
    """Mitsuba's ``path`` with a denoiser."""

    system: Literal["denoised"]

    @property
    def title(self) -> str:
        """The method's name in tables and figures."""
        return f"Path tracer + OIDN, {self.samples}"


class CyclesOptions(_Timed):
    """Cycles, the path tracer of Blender.

    ``guiding``: path guiding. ``denoise``: Open Image Denoise. ``shadow_caustics``: light that
    lamps send through smooth glass into shadows is searched for (manifold next event estimation).
    """

    system: Literal["cycles"]
    guiding: bool = True
    denoise: bool = True
    shadow_caustics: bool = True

    @property
    def title(self) -> str:
        """The method's name in tables and figures."""
        parts = (
            (self.guiding, "no guiding"),
            (self.denoise, "no denoiser"),
            (self.shadow_caustics, "no shadow caustics"),
        )
        return ", ".join(["Cycles", self.effort, *(words for there, words in parts if not there)])


class LuxcoreOptions(_Timed):
    """LuxCore, the renderer behind LuxCoreRender.

    ``caches`` of PhotonGI: ``auto`` is ``caustics``, with paths from the lamps beside those from
    the camera, where there is glass or a mirror, and ``indirect`` elsewhere. ``denoise``: Open
    Image Denoise. The environment variable ``GPF_LUXCORE`` may name a Python with `pyluxcore`.
    """

    system: Literal["luxcore"]
    caches: Literal["auto", "caustics", "indirect", "both", "none"] = "auto"
    denoise: bool = True

    @property
    def title(self) -> str:
        """The method's name in tables and figures."""
        caches = {"auto": [], "both": ["both caches"], "none": ["no caches"]}
        more = caches.get(self.caches, [f"{self.caches} cached"])
        return ", ".join(
            ["LuxCore", self.effort, *more, *([] if self.denoise else ["no denoiser"])]
        )


class FewSamplesOptions(_Options):
    """The field with few samples per pixel, with or without a denoiser."""

    system: Literal["few_samples"]
    spp: Count = 4
    denoise: bool = True

    @property
    def renders_field(self) -> bool:
        """Whether the system renders the trained field."""
        return True

    @property
    def title(self) -> str:
        """The method's name in tables and figures."""
        return f"GPF{' + OIDN' if self.denoise else ''}, {self.spp} spp"


class EmGmmOptions(_Options):
    """Progressive expectation maximisation for photons (Jakob, Regg and Jarosz 2011).

    ``paths`` photon paths are traced in ``passes`` passes, or more, so that none has over 100000
    paths. ``bandwidth``: standard deviation of each photon's kernel, world units, or ``auto``: half
    of the initial standard deviation of a typical component. ``normalisation``: whether the
    Gaussians are normalised over the ``volume``, as in the paper, or for photons in a ``plane``
    (:mod:`baselines.em_gmm.baseline`).
    """

    system: Literal["em_gmm"]
    components: Count = 4096
    paths: Count = 100_000
    passes: Count = 5
    bandwidth: Positive | Literal["auto"] = "auto"
    normalisation: Literal["volume", "plane"] = "volume"
    spp: Count = 4

    @property
    def title(self) -> str:
        """The method's name in tables and figures."""
        return "EM-GMM" if self.normalisation == "volume" else "EM-GMM, in planes"


class InstantNgpOptions(_Learned):
    """Hash grids and small networks, fitted to images (Müller and others 2022).

    ``samples``: number of samples in a training step, over all of its rays.
    """

    system: Literal["instant_ngp"]
    steps: Count = 1000
    samples: Count = 131_072

    @property
    def title(self) -> str:
        """The method's name in tables and figures."""
        return f"Instant-NGP, {self.views} views"


class SplattingOptions(_Learned):
    """3D Gaussian splatting (Kerbl and others 2023).

    ``gaussians``: initial number. ``most``: approximate upper limit of the number during training.
    ``degree``: highest degree of the spherical harmonics.
    """

    system: Literal["splatting"]
    steps: Count = 1000
    gaussians: Count = 8_000
    most: Count = 30_000
    degree: Annotated[int, Field(ge=0, le=3)] = 3

    @property
    def title(self) -> str:
        """The method's name in tables and figures."""
        return f"3D Gaussian splatting, {self.views} views"


class RadianceCacheOptions(_Options):
    """A hash grid and a small network instead of the field's Gaussians.

    ``size``: size of grid and network (:mod:`baselines.radiance_cache.baseline`). ``steps``,
    ``batch`` (points per step) and ``spp`` are those of the field, unless a row sets them.
    """

    system: Literal["radiance_cache"]
    size: Literal["small", "large"] = "large"
    steps: Count | None = None
    batch: Count | None = None
    spp: Count | None = None

    @property
    def learns_from_targets(self) -> bool:
        """Whether the system learns from the same targets as the field."""
        return True

    @property
    def title(self) -> str:
        """The method's name in tables and figures."""
        return f"Neural radiance cache, {self.size}"


class RenderFormerOptions(_Options):
    """RenderFormer (Zeng and others 2025).

    ``triangles``: maximum number; larger scenes are simplified. ``weights``: a folder, or the name
    of a Hugging Face model in the local cache. The environment variable ``GPF_RENDERFORMER`` names
    the folder of the published code.
    """

    system: Literal["renderformer"]
    triangles: Count = 4096
    weights: str = "microsoft/renderformer-v1.1-swin-large"

    @property
    def title(self) -> str:
        """The method's name in tables and figures."""
        return "RenderFormer"


class AnySplatOptions(_Learned):
    """AnySplat (Jiang and others 2025).

    ``weights``: a folder, or the name of a Hugging Face model in the local cache. The environment
    variable ``GPF_ANYSPLAT`` names the folder of the published code.
    """

    system: Literal["anysplat"]
    weights: str = "lhjiang/anysplat"

    @property
    def title(self) -> str:
        """The method's name in tables and figures."""
        return f"AnySplat, {self.views} views"


BaselineOptions = Annotated[
    PathTracerOptions
    | ParticleTracerOptions
    | SppmOptions
    | DenoisedOptions
    | CyclesOptions
    | LuxcoreOptions
    | FewSamplesOptions
    | EmGmmOptions
    | InstantNgpOptions
    | SplattingOptions
    | RadianceCacheOptions
    | RenderFormerOptions
    | AnySplatOptions,
    Field(discriminator="system"),
]
