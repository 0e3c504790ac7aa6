"""The error of a metric that has no number."""


class MetricUnavailable(ValueError):
    """This metric cannot be computed for these images on this machine.

    The message is shown to people as it is: it says what is missing, and what to install or to
    change. Other metrics still work, so :func:`metrics.image.compare` stores ``None`` and the
    message as the reason.
    """
