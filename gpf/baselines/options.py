"""What params.yaml may say of each system, one model per system.

A row of the section ``baselines`` is named as the method is in tables and has a ``system``, which
tells the model that its other keys have to fit.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Count = Annotated[int, Field(ge=1)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class _Options(BaseModel):
    """Common to all systems.

    ``scenes``: the scenes that the method is run for; empty for all of params.yaml.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    scenes: tuple[str, ...] = ()

    @property
    @abstractmethod
    def title(self) -> str:
        """The method's name in tables and figures."""

    @property
    def training_views(self) -> int:
        """How many training views with references the system is given."""
        return 0

    @property
    def learns_from_targets(self) -> bool:
        """Whether the system learns from the points that the field learns from."""
        return False

    @property
    def learns(self) -> bool:
        """Whether the system learns anything that is worth keeping between runs."""
        return self.training_views > 0 or self.learns_from_targets

    @property
    def waits_for_field(self) -> bool:
        """Whether the system is given the time that a view of the field costs."""
        return False

    @property
    def lists(self) -> tuple[str, ...]:
        """The lists of ``methods`` whose stages wait for what the system needs."""
        if self.waits_for_field:
            return ("equal_time",)
        if self.learns:
            return ("learned",)
        return ("classical", "learned")


class _Learned(_Options):
    """A system that knows a scene from pictures alone."""

    views: Count = 3

    @property
    def training_views(self) -> int:
        """How many training views with references the system is given."""
        return self.views


class _Sampled(_Options):
    """A system whose error goes to zero with the number of samples per pixel.

    ``spp: equal_time`` takes as many as fit into the time of a view from the field.
    """

    spp: Count | Literal["equal_time"] = 50

    @property
    def samples(self) -> str:
        """How many there are, as titles tell it."""
        return "equal time" if self.waits_for_field else f"{self.spp} spp"

    @property
    def waits_for_field(self) -> bool:
        """Whether the system is given the time that a view of the field costs."""
        return self.spp == "equal_time"


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
    """Photon mapping with few passes (:mod:`gpf.sppm.passes`)."""

    system: Literal["sppm"]
    passes: Count = 3
    photons_per_pass: Count = 100_000

    @property
    def title(self) -> str:
        """The method's name in tables and figures."""
        return f"SPPM, {self.passes} passes"


class DenoisedOptions(_Sampled):
    """Mitsuba's ``path``, denoised."""

    system: Literal["denoised"]

    @property
    def title(self) -> str:
        """The method's name in tables and figures."""
        return f"Path tracer + OIDN, {self.samples}"


class EmGmmOptions(_Options):
    """Progressive expectation maximisation for photons (Jakob, Regg and Jarosz 2011).

    ``paths`` photon paths come in so many ``passes``, or more of 100000 paths each. ``bandwidth``:
    the standard deviation of the kernel that a photon stands for, world units, or ``auto``: half of
    what a typical component begins with. ``normalisation``: that of the method, over the
    ``volume``, or for photons in a ``plane`` (:mod:`gpf.baselines.em_gmm.baseline`).
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
    """Hash grids and small networks, fitted to pictures (Müller and others 2022).

    ``samples``: along all rays of a step.
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

    ``gaussians`` to start with, about ``most`` once there are more where that helps, with
    spherical harmonics up to a ``degree``.
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
    """A hash grid and a small network in place of the Gaussians.

    ``size``: of both, as :mod:`gpf.baselines.radiance_cache.baseline` describes it. It gets as many steps,
    points in each and camera samples as the field, unless a row says otherwise.
    """

    system: Literal["radiance_cache"]
    size: Literal["small", "large"] = "large"
    steps: Count | None = None
    batch: Count | None = None
    spp: Count | None = None

    @property
    def learns_from_targets(self) -> bool:
        """Whether the system learns from the points that the field learns from."""
        return True

    @property
    def title(self) -> str:
        """The method's name in tables and figures."""
        return f"Neural radiance cache, {self.size}"


class RenderFormerOptions(_Options):
    """RenderFormer (Zeng and others 2025).

    ``triangles``: more are simplified away. ``weights``: a folder, or a name of the Hugging Face
    hub that is in its local cache. The published code is where ``GPF_RENDERFORMER`` says.
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

    ``weights``: a folder, or a name of the Hugging Face hub that is in its local cache. The
    published code is where ``GPF_ANYSPLAT`` says.
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
    | EmGmmOptions
    | InstantNgpOptions
    | SplattingOptions
    | RadianceCacheOptions
    | RenderFormerOptions
    | AnySplatOptions,
    Field(discriminator="system"),
]
