"""The whole predictive distribution of each vehicle, from all of its branches: what predictions are scored by."""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from sumo_hmdp.domain.road import Road
from sumo_hmdp.prediction.branches import Branches, PredictionSettings, covariances, lateral_means
from sumo_hmdp.prediction.dynamics import FloatArray

# Ends of the central 95, 90 and 50 % intervals.
QUANTILES = (0.025, 0.05, 0.25, 0.75, 0.95, 0.975)
# Halvings from a bracket of at most some hundred metres: to a tenth of a millimetre.
_HALVINGS = 20
# Means that differ by less are one [m].
_SAME = 1e-6
# How many standard deviations beyond the outermost means a quantile can be.
_REACH = 6.0


@dataclass(frozen=True)
class Distribution:
    """The prediction of one vehicle as a mixture of all its branches, by step of the horizon (H steps, L lanes).

    Attributes:
        vehicle_id: whose.
        pruned: probability of all branches that were dropped.
        lanes: (H, L) probability of intending each lane, from the branches that were kept; sums to 1 - pruned.
        x_mean: (H,) front bumper [m]; this and all below as if what was dropped were spread as what was kept.
        x_std: (H,) [m].
        y_mean: (H,) [m].
        y_std: (H,) [m].
        x_quantiles: (H, 6) `QUANTILES` of x [m].
    """

    vehicle_id: str
    pruned: float
    lanes: FloatArray
    x_mean: FloatArray
    x_std: FloatArray
    y_mean: FloatArray
    y_std: FloatArray
    x_quantiles: FloatArray


def distributions(branches: Branches, road: Road, settings: PredictionSettings) -> tuple[Distribution, ...]:
    """Return the distribution of every vehicle that has a branch, in their order."""
    if not branches.vehicles:
        return ()
    y = lateral_means(branches, road, settings)
    y_variance = _lateral_variances(branches, settings)
    shares = branches.probability / np.bincount(branches.vehicle, branches.probability)[branches.vehicle]
    quantiles = _quantiles(branches, shares)
    found = []
    for index, vehicle in enumerate(branches.vehicles):
        rows = np.flatnonzero(branches.vehicle == index)
        if not len(rows):
            continue
        weights, x, std = shares[rows], branches.x[rows], branches.x_std[index]
        x_mean, y_mean = weights @ x, weights @ y[rows]
        lanes: FloatArray = np.stack(
            [
                np.bincount(lane - 1, branches.probability[rows], road.lane_count).astype(np.float64)
                for lane in branches.lanes[rows].T
            ]
        )
        found.append(
            Distribution(
                vehicle_id=vehicle.state.id,
                pruned=float(branches.pruned[index]),
                lanes=lanes,
                x_mean=x_mean,
                x_std=np.sqrt(std**2 + weights @ (x - x_mean) ** 2),
                y_mean=y_mean,
                y_std=np.sqrt(weights @ (y_variance[rows] + (y[rows] - y_mean) ** 2)),
                x_quantiles=quantiles[index],
            )
        )
    return tuple(found)


def _lateral_variances(branches: Branches, settings: PredictionSettings) -> FloatArray:
    """Return the variance of y of every branch and step, (B, H) [m2]; branches with equal lateral actions share it."""
    found = np.zeros(branches.x.shape)
    known: dict[tuple[int, bytes], FloatArray] = {}
    for row, (vehicle, laterals) in enumerate(zip(branches.vehicle.tolist(), branches.laterals, strict=True)):
        key = vehicle, laterals.tobytes()
        if key not in known:
            known[key] = covariances(branches, row, settings)[:, 1, 1]
        found[row] = known[key]
    return found


def _quantiles(branches: Branches, shares: FloatArray) -> FloatArray:
    """Return the quantiles of x of every vehicle and step, (V, H, 6) [m]."""
    V, H = branches.x_std.shape
    mixtures = []
    for index in range(V):
        rows = branches.vehicle == index
        for k in range(H):
            places, which = np.unique(np.round(branches.x[rows, k] / _SAME), return_inverse=True)
            mixtures.append((places * _SAME, np.bincount(which, shares[rows], len(places))))
    most = max((len(places) for places, _ in mixtures), default=0)
    means, weights = np.zeros((2, V * H, most))
    for row, (places, share) in enumerate(mixtures):
        means[row, : len(places)], weights[row, : len(places)] = places, share
        means[row, len(places) :] = places[-1] if len(places) else 0.0
    return mixture_quantiles(means, weights, branches.x_std.ravel()).reshape(V, H, -1)


def mixture_quantiles(means: FloatArray, weights: FloatArray, std: FloatArray) -> FloatArray:
    """Return `QUANTILES` of mixtures of normal distributions, (M, 6); of atoms where the spread is 0.

    Args:
        means: (M, N), rising [m].
        weights: (M, N), which sum to 1; those that are not needed are 0.
        std: (M,) of each mixture [m].
    """
    wanted = np.array(QUANTILES)
    if not means.size:
        return np.zeros((len(means), len(wanted)))
    atoms = np.take_along_axis(
        means, np.minimum((np.cumsum(weights, axis=1)[:, :, None] < wanted - 1e-12).sum(axis=1), means.shape[1] - 1), 1
    )
    spread = np.where(std > 0, std, 1.0)
    low = np.repeat((means.min(axis=1) - _REACH * spread)[:, None], len(wanted), axis=1)
    high = np.repeat((means.max(axis=1) + _REACH * spread)[:, None], len(wanted), axis=1)
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        z = (middle[:, :, None] - means[:, None, :]) / spread[:, None, None]
        below = (ndtr(z) * weights[:, None, :]).sum(axis=2) < wanted
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.where(std[:, None] > 0, (low + high) / 2, atoms)
