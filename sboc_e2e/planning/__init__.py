"""Plans: a TOML file names a scenario, what is to be observed and for how long; the result is a schedule that the chain can fly."""

from sboc_e2e.planning.make import make_plan
from sboc_e2e.planning.request import PlanRequest, read_request

__all__ = ["PlanRequest", "make_plan", "read_request"]
