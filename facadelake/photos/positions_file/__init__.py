"""The positions file of a campaign: read, matched to the photographs, compared with their own metadata."""
