"""The passport of a campaign: facts, geometry and sheet."""
