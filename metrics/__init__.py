"""Numbers about images (their quality) and about stages (their cost).

Nothing here imports the renderer: images are arrays, times are seconds. Bad arguments raise
``ValueError``. A metric that this machine cannot compute raises
:class:`metrics.errors.MetricUnavailable`; its message says what to install or change.
"""
