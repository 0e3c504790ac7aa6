"""Explain Mitsuba's errors during light tracing: a material or a texture does not support it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from gpf.core.errors import UserError


@contextmanager
def telling_untraceable(where: str) -> Iterator[None]:
    """Turn a Mitsuba error in the block into a :class:`UserError`; ``where`` names the scene.

    Mitsuba's messages begin with the class that raised them, in brackets. An error from Dr.Jit or
    Python is a bug in this program, and keeps its traceback.
    """
    try:
        yield
    except RuntimeError as error:
        origin = _origin_of(error)
        message = str(origin).strip().partition("\n")[0]
        if not isinstance(origin, RuntimeError) or not message.startswith("["):
            raise
        todo = "Replace the material or emitter that Mitsuba names."
        if "eval_1_grad" in message:
            todo = "Give the bumpmap a bitmap texture: the slope of this one cannot be evaluated."
        raise UserError(where, f"cannot be traced: {message}", todo) from error


def _origin_of(error: BaseException) -> BaseException:
    """The first error of a chain: Dr.Jit wraps errors that occur inside its loops."""
    while inner := error.__cause__ or error.__context__:
        error = inner
    return error
