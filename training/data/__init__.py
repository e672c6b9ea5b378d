"""Training, validation and test data: pictures with boxes, split by site, and pictures without defects."""
