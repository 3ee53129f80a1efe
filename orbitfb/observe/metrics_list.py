"""The list of all metrics: the Collector and the page of the docs are made from it."""

from orbitfb.observe.metrics_beam import BEAM
from orbitfb.observe.metrics_learning import LEARNING
from orbitfb.observe.metrics_loop import LOOP
from orbitfb.observe.metrics_service import DIAGNOSIS, SERVICE

METRICS = LOOP + BEAM + LEARNING + DIAGNOSIS + SERVICE
"""All metrics that a scrape exposes, and no other."""
