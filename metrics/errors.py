"""Why a metric has no number."""


class MetricUnavailable(ValueError):
    """One metric cannot be computed for these images on this machine.

    The words are made to be shown as they are: what is missing, and the command
    or the change that mends it. The other metrics are not concerned, so
    ``metrics.image.compare`` turns it into ``None`` and a reason.
    """
