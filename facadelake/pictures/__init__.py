"""Pictures for people: facade elevations from rectified photographs, plans, overlays, the report of a campaign."""
