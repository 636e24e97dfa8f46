"""The engine under the estimators: unknowns, shooting, Gauss-Newton, covariance, Fit."""
