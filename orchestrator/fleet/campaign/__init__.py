"""Thousands of virtual commissionings on a fleet: simulated, analysed and scored, to find what a bench can detect."""

from orchestrator.fleet.campaign._job import CampaignJob
from orchestrator.fleet.campaign._plan import check_runs, load_campaign, runs_of
from orchestrator.fleet.campaign._power import PowerReport, power_of

__all__ = [
    "CampaignJob",
    "PowerReport",
    "check_runs",
    "load_campaign",
    "power_of",
    "runs_of",
]
