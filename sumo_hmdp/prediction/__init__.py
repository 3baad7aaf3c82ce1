"""Prediction of surrounding vehicles: policies, affine-Gaussian motion, branches."""
