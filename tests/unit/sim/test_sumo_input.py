"""What SUMO is started with, where it drives the ego and where it does not."""

from pathlib import Path
from xml.etree import ElementTree as ET

from sumo_hmdp.decision.sumo_driver import SumoDriver
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.sim.sumo_input import sumo_command, vehicle_types
from sumo_hmdp.traffic.spawn import DriverKind, Spawn

EGO = VehicleState("ego", x=0.0, y=0.0, speed=30.0, lane=2)
OTHERS = (Spawn("s", 1, 50.0, 20.0), Spawn("i", 3, 50.0, 20.0, DriverKind.IDM, desired_speed=25.0))
DRIVER = SumoDriver(lane_change_time=8.0, desired_speed=31.0, keep_right=0.5, forbidden_lanes=frozenset({3}))


def types(driver=None):
    root = ET.fromstring(vehicle_types(EGO, OTHERS, 0.15, driver))  # noqa: S314 (it is our own text)
    return {element.attrib.pop("id"): element.attrib for element in root}


def command(driver=None):
    return sumo_command(
        Path("net.xml"), Path("types.xml"), 0.15, 7, None if driver is None else driver.lane_change_time
    )


def test_lane_changes_take_their_time_where_there_is_one():
    assert command(DRIVER) == [*command(), "--lanechange.duration", "8.0"]
    assert not any("lanechange.duration" in word for word in command())


def test_the_type_of_a_driven_ego():
    ego = types(DRIVER)["type-of-ego"]
    assert (ego["carFollowModel"], ego["laneChangeModel"], ego["maxSpeed"]) == ("IDM", "LC2013", "31.0")
    assert (ego["minGap"], ego["tau"], ego["accel"], ego["decel"], ego["delta"]) == ("2.0", "1.5", "1.5", "2.0", "4.0")
    assert (ego["lcSpeedGain"], ego["lcKeepRight"], ego["lcAssertive"]) == ("1.0", "0.5", "1.0")
    assert (ego["lcOvertakeRight"], ego["stepping"], ego["speedDev"]) == ("1", "0.15", "0")


def test_the_ego_has_a_class_of_its_own_only_where_a_lane_is_forbidden():
    assert types(DRIVER)["type-of-ego"]["vClass"] == "custom1"
    assert "vClass" not in types(SumoDriver(lane_change_time=8.0))["type-of-ego"]


def test_everybody_else_is_the_same_whoever_drives_the_ego():
    driven, moved = types(DRIVER), types()
    assert driven.pop("type-of-ego") != moved.pop("type-of-ego")
    assert driven == moved
    assert "carFollowModel" not in moved["type-of-s"]
    assert moved["type-of-i"]["maxSpeed"] == "25.0"
