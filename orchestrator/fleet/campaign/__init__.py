"""Thousands of virtual commissionings on a fleet: simulated, analysed and scored, to find what a bench can detect."""

from orchestrator.fleet.campaign._job import CampaignJob
from orchestrator.fleet.campaign._plan import CampaignPlan, Condition, Run, check_runs, load_campaign, runs_of
from orchestrator.fleet.campaign._power import PowerReport, PowerRow, Smallest, power_of

__all__ = [
    "CampaignJob",
    "CampaignPlan",
    "Condition",
    "PowerReport",
    "PowerRow",
    "Run",
    "Smallest",
    "check_runs",
    "load_campaign",
    "power_of",
    "runs_of",
]
