"""Shapes of the JSON files that stages write and other stages and the report read."""

from typing import Annotated

from pydantic import ConfigDict, Field, with_config
from typing_extensions import TypedDict  # pydantic cannot read that of Python 3.11

_Finite = Annotated[float, Field(allow_inf_nan=False)]
_Seconds = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class Part(TypedDict):
    """Seconds of a part of a stage."""

    wall_seconds: _Seconds
    cpu_seconds: _Finite  # negative if others kept the machine busy while kernels were compiled
    compile_seconds: _Seconds


@with_config(ConfigDict(extra="allow"))
class Facts(TypedDict, total=False):
    """Numbers that a stage records beside its parts; other keys are allowed."""

    views: Annotated[int, Field(ge=1)]
    seconds_per_single_view_pass: _Seconds
    seconds_per_shared_view_pass: _Seconds
    seconds_per_target_pass: _Seconds
    passes_done: dict[str, int]
    field_megabytes: _Finite
    storage_megabytes: _Finite
    peak_memory_megabytes: _Finite
    path_seconds: _Seconds


class CostFile(TypedDict):
    """The shape of a cost file."""

    parts: dict[str, Part]
    facts: Facts


class Point(TypedDict):
    """A point of SPPM's convergence curve; the file holds a list of them."""

    passes: Annotated[int, Field(ge=1)]
    psnr: _Finite


@with_config(ConfigDict(extra="allow"))
class Mean(TypedDict):
    """Means of the metrics over the novel views."""

    psnr: _Finite


class Judged(TypedDict):
    """The metrics of a method's images, and why some of them are missing."""

    mean: Mean
    reasons: dict[str, str]


class NotJudged(TypedDict):
    """Instead of metrics: why a method has no images of a scene."""

    cannot_serve: str


class Refusal(TypedDict):
    """Why a method cannot serve a scene, as its stage wrote it instead of images."""

    reason: str
