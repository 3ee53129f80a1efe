"""The list of all metrics: the Collector and the page of the docs are made from it."""

from orbitfb.observe.metrics.beam import BEAM
from orbitfb.observe.metrics.learning import LEARNING
from orbitfb.observe.metrics.loop import LOOP
from orbitfb.observe.metrics.service import DIAGNOSIS, SERVICE

METRICS = LOOP + BEAM + LEARNING + DIAGNOSIS + SERVICE
"""All metrics that a scrape exposes, and no other."""
