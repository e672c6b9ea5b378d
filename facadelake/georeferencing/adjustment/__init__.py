"""The georeferenced bundle adjustment: observations, reduced camera system, solution and covariance."""
