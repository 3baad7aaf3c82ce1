"""MOBIL written from the paper's formulas with plain loops over scalars: the oracle of the vectorised one."""

import math
from dataclasses import dataclass

from sumo_hmdp.traffic.mobil import Passing


@dataclass(frozen=True)
class Car:
    x: float
    speed: float
    lane: int
    second: int = 0
    length: float = 4.0
    politeness: float = 0.0
    desired: float = 30.0
    min_gap: float = 2.0
    time_gap: float = 1.5
    accel: float = 2.0
    decel: float = 2.0
    exponent: float = 4.0


def idm(car, gap, lead_speed):
    free = 1 - (car.speed / car.desired) ** car.exponent
    if gap == math.inf:
        return max(car.accel * free, -9.0)
    closing = car.speed - lead_speed
    dynamic = car.speed * car.time_gap + car.speed * closing / (2 * math.sqrt(car.accel * car.decel))
    wanted = car.min_gap + max(0.0, dynamic)
    return max(car.accel * (free - (wanted / max(gap, 0.001)) ** 2), -9.0)


class Loops:
    """One step's decisions."""

    def __init__(self, cars, rule, allowed, may_change, bias, ends):
        self.cars, self.rule, self.allowed, self.may, self.bias, self.ends = cars, rule, allowed, may_change, bias, ends

    def ahead(self, i, lane):
        others = [
            j
            for j, o in enumerate(self.cars)
            if j != i and lane in (o.lane, o.second) and self.order(j) > self.order(i)
        ]
        # Of two that are level the one with the nearer rear.
        return min(others, key=lambda j: (self.cars[j].x - self.cars[j].length, *self.order(j)), default=None)

    def behind(self, i, lane):
        others = [
            j
            for j, o in enumerate(self.cars)
            if j != i and lane in (o.lane, o.second) and self.order(j) < self.order(i)
        ]
        return max(others, key=self.order, default=None)

    def order(self, j):
        return (self.cars[j].x, j)

    def gap(self, follower, leader):
        return math.inf if leader is None else self.cars[leader].x - self.cars[leader].length - self.cars[follower].x

    def bare(self, follower, leader):
        lead_speed = 0.0 if leader is None else self.cars[leader].speed
        return idm(self.cars[follower], self.gap(follower, leader), lead_speed)

    def accel(self, follower, leader, lane):
        end_gap = self.ends[follower][lane - 1] - self.cars[follower].x
        return min(self.bare(follower, leader), idm(self.cars[follower], end_gap, 0.0))

    def without_passing(self, i, lane):
        """Return the paper's a_eur in a lane."""
        mine = self.accel(i, self.ahead(i, lane), lane)
        if lane == 1:
            return mine
        left = self.ahead(i, lane - 1)
        if left is None:
            return mine
        if self.cars[i].speed > self.cars[left].speed > self.rule.critical_speed:
            return min(mine, self.bare(i, left))
        return mine

    def incentive(self, i, step):
        """Return the incentive of a change by `step` lanes, None where it is impossible."""
        car, rule = self.cars[i], self.rule
        here, there = car.lane, car.lane + step
        if car.second or not self.may[i] or not 1 <= there <= len(self.allowed[i]) or not self.allowed[i][there - 1]:
            return None
        lead_here, lead_there = self.ahead(i, here), self.ahead(i, there)
        old, new = self.behind(i, here), self.behind(i, there)
        stay, go = self.accel(i, lead_here, here), self.accel(i, lead_there, there)
        if min(self.gap(i, lead_there), self.ends[i][there - 1] - car.x) < rule.least_gap:
            return None
        if new is not None and (self.gap(new, i) < rule.least_gap or self.bare(new, i) < -rule.safe_decel):
            return None
        if go < -rule.safe_decel and go < stay:
            return None
        gain_new = 0.0 if new is None else self.accel(new, i, there) - self.accel(new, lead_there, there)
        gain_old = 0.0 if old is None else self.accel(old, lead_here, here) - self.accel(old, i, here)
        bias = self.bias[i][0 if step < 0 else 1] + step * rule.right_bias
        if rule.passing is Passing.ANY_SIDE:
            return go - stay + car.politeness * (gain_new + gain_old) + bias
        gain = self.without_passing(i, there) - self.without_passing(i, here)
        return gain + car.politeness * (gain_new if step < 0 else gain_old) + bias

    def choose(self):
        wishes = []
        for i in range(len(self.cars)):
            best = None
            for step in (-1, 1):
                value = self.incentive(i, step)
                if value is not None and value > self.rule.threshold and (best is None or value > best[0]):
                    best = (value, step)
            if best is not None:
                wishes.append((-best[0], i, best[1]))
        moves, gone = [0] * len(self.cars), []
        for _, i, step in sorted(wishes):
            target = self.cars[i].lane + step
            if all(self.apart(i, j) for j, lane in gone if lane == target):
                moves[i] = step
                gone.append((i, target))
        return moves

    def apart(self, i, j):
        rear, front = sorted((i, j), key=self.order)
        return self.gap(rear, front) >= self.rule.least_gap and self.bare(rear, front) >= -self.rule.safe_decel
