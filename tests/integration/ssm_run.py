"""One vehicle after another in SUMO with its SSM device on the follower; as a script it prints every instant as JSON.

A process of its own: SUMO's options cannot be added to those of a run of the package.
"""

import json
import os
import sys
from pathlib import Path

NET = Path(__file__).parents[2] / "networks" / "highway_3x4m.net.xml"
DT, STEPS, MIN_GAP = 0.1, 150, 2.0
TYPES = f"""<additional>
<vType id="car" length="4.0" width="1.8" minGap="{MIN_GAP}" speedFactor="10" maxSpeed="100" speedDev="0"/>
<vType id="truck" length="9.0" width="2.4" minGap="{MIN_GAP}" speedFactor="10" maxSpeed="100" speedDev="0"/>
</additional>"""


def speeds(time, braking_from):
    """Return the speeds of ego and leader [m/s]: the leader brakes, the ego after it, and falls behind in the end."""
    leader = 20.0 if time < 3.0 else max(8.0, 20.0 - 4.0 * (time - 3.0))
    ego = 22.0 if time < braking_from else max(6.0, 22.0 - 6.0 * (time - braking_from))
    return ego, leader


def main(folder, braking_from):
    os.environ["LIBSUMO_AS_TRACI"] = "quiet"
    import libsumo  # noqa: PLC0415 - the variable has to be set before

    types = folder / "types.xml"
    types.write_text(TYPES, encoding="utf-8")
    options = {
        "net-file": NET, "additional-files": types, "step-length": DT, "seed": 1, "no-step-log": "true",
        "no-warnings": "true", "insertion-checks": "none", "collision.action": "none",
        # Far enough to see the leader from the start, as the metrics do; 50 m is the device's default.
        "device.ssm.explicit": "ego", "device.ssm.measures": "TTC DRAC", "device.ssm.range": 200.0,
        "device.ssm.file": folder / "ssm.xml",
    }  # fmt: skip
    libsumo.start(["sumo", *(word for name, value in options.items() for word in (f"--{name}", str(value)))])
    edge = next(name for name in libsumo.edge.getIDList() if not name.startswith(":"))
    libsumo.route.add("route", [edge])
    rows = []
    for name, kind, x in (("ego", "car", "100"), ("leader", "truck", "140")):
        libsumo.vehicle.add(name, "route", kind, departLane="1", departPos=x, departSpeed="20")
        libsumo.vehicle.setSpeedMode(name, 0)
        libsumo.vehicle.setLaneChangeMode(name, 0)
    for step in range(STEPS):
        for name, speed in zip(("ego", "leader"), speeds(step * DT, braking_from), strict=True):
            libsumo.vehicle.setSpeed(name, float(speed))
        libsumo.simulationStep()
        row = {"time_s": (step + 1) * DT}
        for name in ("ego", "leader"):
            row[name] = [libsumo.vehicle.getLanePosition(name), libsumo.vehicle.getSpeed(name)]
        for name in ("minTTC", "maxDRAC"):
            row[name] = libsumo.vehicle.getParameter("ego", f"device.ssm.{name}")
        rows.append(row)
    libsumo.close()
    print(json.dumps(rows))


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]))
