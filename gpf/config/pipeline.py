"""Sections of params.yaml that configure the pipeline; those of the library stand in its packages."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from gpf.core.settings import Count, Positive, Settings


class Runtime(Settings):
    """Where kernels run."""

    variant: Literal["auto", "llvm_ad_rgb", "cuda_ad_rgb"] = "auto"


class Cluster(Settings):
    """Where ``executor: ray`` finds its workers (:mod:`stages.references.cluster`)."""

    address: str = ""
    workers: Count = 2
    threads: Annotated[int, Field(ge=0)] = 1
    passes_per_task: Count = 10
    retries: Annotated[int, Field(ge=0)] = 3


class Film(Settings):
    """Size of all images; the width follows from the scene's aspect."""

    height: Annotated[int, Field(ge=4, le=8192)] = 256


MethodName = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_]*$")]

# What the pipeline renders itself, by the names that it has in tables.
OWN_METHODS = ("gpf", "second_reference")


class Methods(Settings):
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


class Variant(Settings):
    """The field made otherwise: dotted keys of params.yaml and what they are there."""

    group: MethodName
    title: str = ""
    set: dict[str, Any] = Field(default_factory=dict)


class Ablations(Settings):
    """Variants of the field, those that run, and the scenes that they run in."""

    scenes: tuple[str, ...] = ()
    run: tuple[MethodName, ...] = ()
    variants: dict[MethodName, Variant] = Field(default_factory=dict)

    def asks_for(self, scene: str, variant: str) -> bool:
        """Whether the pipeline makes a variant in a scene, and keeps it up to date."""
        return scene in self.scenes and variant in self.run


class Animation(Settings):
    """The camera path of water scenes, by several methods side by side."""

    scenes: tuple[str, ...] = ()
    methods: tuple[MethodName, ...] = ("gpf",)
    fps: Annotated[int, Field(ge=1, le=120)] = 12


class Metrics(Settings):
    """What images are compared by (:mod:`metrics.image`)."""

    relmse_epsilon: Positive = 0.01


class Amortize(Settings):
    """Cumulative cost over the number of views (:mod:`metrics.cost`)."""

    views: Annotated[int, Field(ge=2, le=100_000)] = 100
