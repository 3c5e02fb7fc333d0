"""Campaigns: one scenario over a grid or random draws of any of its keys, one result shard for each task."""

from sboc_e2e.campaign.engine import CampaignResult, run_campaign
from sboc_e2e.campaign.plan import Campaign, Task, read_campaign

__all__ = ["Campaign", "CampaignResult", "Task", "read_campaign", "run_campaign"]
