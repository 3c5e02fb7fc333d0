"""Plans: a file names a scenario and what is to be observed; the result is a schedule that the chain can fly."""

from sboc_e2e.planning.make import make_plan
from sboc_e2e.planning.request import PlanRequest, read_request

__all__ = ["PlanRequest", "make_plan", "read_request"]
