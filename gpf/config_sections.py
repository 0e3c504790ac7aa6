"""The sections of params.yaml, typed: one frozen model for each.

The comments in params.yaml explain the keys to users; the docstrings here say what they become.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PlainValidator
from pydantic_core import PydanticCustomError

Count = Annotated[int, Field(ge=1)]
Seed = Annotated[int, Field(ge=0, lt=2**31)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, lt=1)]


def _check_length(value: object) -> float | Literal["auto"]:
    """One check instead of a union, whose errors would name its branches instead of the key."""
    if value == "auto":
        return "auto"
    if isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < math.inf:
        return float(value)
    raise PydanticCustomError("length", "Input should be a number greater than 0, or auto")


Length = Annotated[float | Literal["auto"], PlainValidator(_check_length)]


def _check_count(value: object) -> int | Literal["auto"]:
    if value == "auto":
        return "auto"
    if isinstance(value, int) and not isinstance(value, bool) and value > 0:
        return value
    raise PydanticCustomError("count", "Input should be a whole number greater than 0, or auto")


AutoCount = Annotated[int | Literal["auto"], PlainValidator(_check_count)]


class Section(BaseModel):
    """Frozen; unknown keys are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Runtime(Section):
    """Where kernels run."""

    variant: Literal["auto", "llvm_ad_rgb", "cuda_ad_rgb"] = "auto"


class Cluster(Section):
    """Where ``executor: ray`` finds its workers (:mod:`stages.cluster`)."""

    address: str = ""
    workers: Count = 2
    threads: Annotated[int, Field(ge=0)] = 1
    passes_per_task: Count = 10
    retries: Annotated[int, Field(ge=0)] = 3


class Film(Section):
    """Size of all images; the width follows from the scene's aspect."""

    height: Annotated[int, Field(ge=4, le=8192)] = 256


class OutlookSection(Section):
    """Where Gaussians and supervision are needed (:class:`gpf.outlook.Outlook`)."""

    use: bool = True
    rays: Annotated[int, Field(ge=1000)] = 524_288
    guide: bool = True
    pilot_paths: Annotated[int, Field(ge=1000)] = 1_048_576
    seed: Seed = 5


class Reference(Section):
    """SPPM references and targets (:mod:`gpf.reference`)."""

    passes: Annotated[int, Field(ge=4)] = 250
    photons_per_pass: AutoCount = "auto"
    initial_radius: Length = "auto"
    alpha: Annotated[float, Field(gt=0, lt=1)] = 0.7
    direct: Literal["photons", "emitters"] = "emitters"
    glossy_walks: Count = 8
    edge_correction: bool = True
    rr_depth: Count = 5
    view_points: Count = 200_000
    surface_points: Annotated[int, Field(ge=0)] = 300_000
    images: Annotated[int, Field(ge=0)] | Literal["auto"] = "auto"
    seed: Seed = 1
    checkpoint_seconds: Positive = 30.0
    preview_seconds: Annotated[float, Field(ge=0)] = 10.0
    target_psnr: Annotated[float, Field(ge=0)] = 0.0


class Photons(Section):
    """The photons that become Gaussians (:mod:`gpf.photon_tracing`)."""

    paths: AutoCount = "auto"
    rr_depth: Count = 5
    seed: Seed = 2


class FieldSection(Section):
    """The field's make, query (:mod:`gpf.field`) and file (:mod:`gpf.field_files`)."""

    gaussians: AutoCount = "auto"
    initialization: Literal["photons", "random"] = "photons"
    fill_gaps: bool = True
    initial_colour: Literal["targets", "density", "flux"] = "targets"
    initial_scale: Length = "auto"
    search_radius: Length = "auto"
    neighbours: Literal["both", "radius", "knn"] = "both"
    k: Annotated[int, Field(ge=1, le=32)] = 3
    blend: Literal["divided", "sum"] = "divided"
    stores: Literal["irradiance", "radiance"] = "irradiance"
    direct: Literal["field", "emitters"] = "field"
    normal_test: bool = True
    anisotropic: bool = True
    precision: Literal["float32", "compact"] = "float32"


class Rates(Section):
    """Adam's learning rates (:class:`gpf.training.LearningRates`)."""

    means: NotNegative = 8e-3
    log_scales: NotNegative = 2e-2
    quats: NotNegative = 2e-2
    irradiance: NotNegative = 8e-2


class Train(Section):
    """Fitting the field (:mod:`gpf.training`)."""

    steps: Count = 500
    batch: Count = 32_768
    points: Literal["views", "surface", "both"] = "both"
    supervision: Literal["reference", "streaming"] = "reference"
    loss: Literal["squared", "relative"] = "relative"
    rates: Rates = Rates()
    final_rate: Annotated[float, Field(gt=0, le=1)] = 0.1
    rebuild_every: Count = 100
    evaluate_every: Count = 50
    held_out: Share = 0.1
    seed: Seed = 3
    checkpoint_seconds: Positive = 30.0


class Stream(Section):
    """Passes of photons that come in while the field is trained (:mod:`gpf.streaming`)."""

    passes: Count = 300
    first: Count = 24
    growth: Annotated[float, Field(gt=1)] = 2.0
    alpha: Annotated[float, Field(gt=0, lt=1)] = 0.75
    radius: Positive = 1.3
    view_points: Count = 200_000
    surface_points: Count = 300_000
    seed: Seed = 6


class Render(Section):
    """Rendering novel views from the field (:mod:`gpf.integrators.gpf`)."""

    spp: Count = 64
    glossy_walks: Count = 4
    adaptive: bool = True
    suppress_fireflies: bool = True
    sampler: Literal["independent", "stratified", "multijitter", "ldsampler"] = "multijitter"
    rr_depth: Count = 5
    seed: Seed = 4


MethodName = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_]*$")]

# What the pipeline renders itself, by the names that it has in tables.
OWN_METHODS = ("gpf", "ceiling")


class Methods(Section):
    """Which rows of ``baselines`` the pipeline runs, by what they wait for: the scene, the time
    of a view from the field, or references of training views."""

    classical: tuple[MethodName, ...] = ()
    equal_time: tuple[MethodName, ...] = ()
    learned: tuple[MethodName, ...] = ()

    @property
    def all(self) -> tuple[str, ...]:
        """All of them, in the order that tables have."""
        return (*self.classical, *self.equal_time, *self.learned)


# Sections that a variant of an ablation may change: scene and references stay as they are.
VARIED = ("field", "train", "stream", "render")


class Variant(Section):
    """The field made otherwise: dotted keys of params.yaml and what they are there."""

    group: MethodName
    title: str = ""
    set: dict[str, Any] = Field(default_factory=dict)


class Ablations(Section):
    """Variants of the field, those that run, and the scenes that they run in."""

    scenes: tuple[str, ...] = ()
    run: tuple[MethodName, ...] = ()
    variants: dict[MethodName, Variant] = Field(default_factory=dict)

    def asks_for(self, scene: str, variant: str) -> bool:
        """Whether the pipeline makes a variant in a scene, and keeps it up to date."""
        return scene in self.scenes and variant in self.run


class Animation(Section):
    """The camera path of water scenes, by several methods side by side."""

    scenes: tuple[str, ...] = ()
    methods: tuple[MethodName, ...] = ("gpf",)
    fps: Annotated[int, Field(ge=1, le=120)] = 12


class Metrics(Section):
    """What images are compared by (:mod:`metrics.image`)."""

    relmse_epsilon: Positive = 0.01


class Amortize(Section):
    """Cumulative cost over the number of views (:mod:`metrics.cost`)."""

    views: Annotated[int, Field(ge=2, le=100_000)] = 100
