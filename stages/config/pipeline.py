"""Pipeline sections of params.yaml; the sections for the library are in its packages."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from gpf.core.settings import Count, NotNegative, Positive, Settings


class Runtime(Settings):
    """The Mitsuba variant; see :func:`gpf.core.runtime.choose_variant`."""

    variant: Literal["auto", "llvm_ad_rgb", "cuda_ad_rgb"] = "auto"


class Cluster(Settings):
    """The workers of ``executor: ray`` (:mod:`stages.references.cluster`)."""

    address: str = ""
    workers: Count = 2
    threads: Annotated[int, Field(ge=0)] = 1
    passes_per_task: Count = 10
    retries: Annotated[int, Field(ge=0)] = 3


class Film(Settings):
    """Height of all images, pixels; the width follows from the scene's aspect."""

    height: Annotated[int, Field(ge=4, le=8192)] = 256


MethodName = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_]*$")]

# Names of the results that are not rows of `baselines`: the field and the second reference.
OWN_METHODS = ("gpf", "second_reference")


class Methods(Settings):
    """The rows of ``baselines`` that the pipeline runs, grouped by prerequisites.

    Attributes
    ----------
    classical: rows that need only the scene.
    equal_time: rows that need the field, or its render time.
    learned: rows that need references of training views.
    """

    classical: tuple[MethodName, ...] = ()
    equal_time: tuple[MethodName, ...] = ()
    learned: tuple[MethodName, ...] = ()

    @property
    def all(self) -> tuple[str, ...]:
        """All rows, in table order."""
        return (*self.classical, *self.equal_time, *self.learned)


# Sections that a variant may change; all variants share the scene and the references.
VARIED = ("field", "train", "stream", "render")


class Variant(Settings):
    """A variant of the field: dotted keys of params.yaml and their values."""

    group: MethodName
    title: str = ""
    set: dict[str, Any] = Field(default_factory=dict)


class Ablations(Settings):
    """Variants of the field, the names of those to run, and the scenes to run them in."""

    scenes: tuple[str, ...] = ()
    run: tuple[MethodName, ...] = ()
    variants: dict[MethodName, Variant] = Field(default_factory=dict)

    def asks_for(self, scene: str, variant: str) -> bool:
        """Whether the pipeline runs a variant in a scene."""
        return scene in self.scenes and variant in self.run


class Progress(Settings):
    """How often long stages save and show what they have. Changes no result.

    Attributes
    ----------
    checkpoint_seconds: time between checkpoints.
    preview_seconds: time between preview images of references; 0: no previews.
    """

    checkpoint_seconds: Positive = 30.0
    preview_seconds: NotNegative = 10


class Animation(Settings):
    """Films along the scenes' camera paths, with several methods side by side."""

    scenes: tuple[str, ...] = ()
    methods: tuple[MethodName, ...] = ("gpf",)
    fps: Annotated[int, Field(ge=1, le=120)] = 12


class Metrics(Settings):
    """Settings of the image metrics (:mod:`metrics.image`)."""

    relmse_epsilon: Positive = 0.01


class Amortize(Settings):
    """Cumulative cost over the number of views (:mod:`metrics.cost`)."""

    views: Annotated[int, Field(ge=2, le=100_000)] = 100
