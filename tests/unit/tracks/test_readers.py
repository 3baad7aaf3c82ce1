"""Readers of recorded tracks on small files of our own: right, or refused in one line."""

import csv

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from sumo_hmdp.errors import InputError
from sumo_hmdp.tracks.load import Source, read_tracks

DT = 0.1
LINES = (0.0, -3.5, -7.0)


def rows(count=21, speed=10.0, start=0.0, y=-1.75, name="1", length=4.0):
    """A vehicle at constant speed as rows of the plain table, its centre at `start` first."""
    return [
        {"id": name, "time_s": round(k * DT, 3), "x_m": start + speed * k * DT, "y_m": y, "speed_mps": speed,
         "length_m": length, "width_m": 1.8}
        for k in range(count)
    ]  # fmt: skip


def two():
    return rows() + rows(name="2", start=30.0, y=-5.25, length=8.0)


def write(path, table):
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(table[0]))
        writer.writeheader()
        writer.writerows(table)
    return path


def plain(path, table, **changes):
    return read_tracks(Source(write(path / "t.csv", table), "plain", **{"lane_lines": LINES, **changes}))


def refusal(call):
    with pytest.raises(InputError) as error:
        call()
    (line,) = error.value.lines()
    return line


def test_front_bumper_is_half_a_length_ahead_of_the_centre(tmp_path):
    traffic = plain(tmp_path, two())
    assert (traffic.road.lane_count, traffic.road.lane_width) == (2, 3.5)
    assert traffic.span == pytest.approx(2.0)
    state = traffic.tracks["2"].at(1.0, traffic.road)
    # The road's x begins where the record's first centre is.
    assert (state.x, state.y, state.lane) == pytest.approx((30.0 + 10.0 + 4.0, -1.75, 2))
    assert (state.speed, state.accel, state.heading) == pytest.approx((10.0, 0.0, 0.0), abs=1e-9)


def test_between_instants_positions_are_linear(tmp_path):
    traffic = plain(tmp_path, two())
    assert traffic.tracks["1"].at(0.25, traffic.road).x == pytest.approx(2.5 + 2.0)


def test_parquet_is_read_as_csv(tmp_path):
    columns = {key: [row[key] for row in two()] for key in two()[0]}
    pq.write_table(pa.table(columns), tmp_path / "t.parquet")
    found = read_tracks(Source(tmp_path / "t.parquet", "plain", lane_lines=LINES))
    wanted = plain(tmp_path, two())
    for name, track in wanted.tracks.items():
        np.testing.assert_allclose(found.tracks[name].x, track.x, atol=1e-12)


def ngsim(scale):
    """The two vehicles as NGSIM has them: Local_Y of the front bumper, Local_X to the right."""
    return [
        {"Vehicle_ID": r["id"], "Frame_ID": 7 + round(r["time_s"] / DT), "Local_X": -r["y_m"] / scale,
         "Local_Y": (r["x_m"] + 0.5 * r["length_m"] + 5.0) / scale, "v_length": r["length_m"] / scale,
         "v_Width": 1.8 / scale, "v_Vel": 10.0 / scale, "Lane_ID": 1}
        for r in two()
    ]  # fmt: skip


def test_ngsim_in_feet_is_the_same_traffic(tmp_path):
    source = Source(write(tmp_path / "n.csv", ngsim(0.3048)), "ngsim", "feet", (0.0, 3.5, 7.0))
    found, wanted = read_tracks(source), plain(tmp_path, two())
    for name, track in wanted.tracks.items():
        np.testing.assert_allclose(found.tracks[name].x, track.x, atol=1e-9)
        np.testing.assert_allclose(found.tracks[name].y, track.y, atol=1e-9)


def test_units_are_stated_and_believed_only_where_they_can_be(tmp_path):
    path = write(tmp_path / "n.csv", ngsim(0.3048))
    assert "tracks.units: is missing" in refusal(lambda: read_tracks(Source(path, "ngsim", None, (0.0, 3.5, 7.0))))
    line = refusal(lambda: read_tracks(Source(path, "ngsim", "metres", (0.0, 3.5, 7.0))))
    assert "1.2 to 3 m wide" in line
    assert "Check the units" in line


def highd(tmp_path, carriageway):
    """The two vehicles on both carriageways of a highD-like recording; its y points down."""
    table, sign = [], {"lower": 1.0, "upper": -1.0}[carriageway]
    middle = {"lower": 20.0, "upper": 8.0}[carriageway]
    for r in two():
        x, y = sign * r["x_m"] + 100.0, middle - sign * r["y_m"]
        table.append(
            {"frame": 1 + round(r["time_s"] / DT), "id": r["id"], "x": x - 0.5 * r["length_m"], "y": y - 0.9,
             "width": r["length_m"], "height": 1.8, "xVelocity": sign * 10.0, "yVelocity": 0.0}
        )  # fmt: skip
    path = write(tmp_path / "01_tracks.csv", table)
    meta = {"frameRate": 10, "upperLaneMarkings": "8.0;4.5;1.0", "lowerLaneMarkings": "20.0;23.5;27.0"}
    write(tmp_path / "01_recordingMeta.csv", [meta])
    return Source(path, "highd", carriageway=carriageway)


@pytest.mark.parametrize("carriageway", ["lower", "upper"])
def test_both_directions_of_highd_run_forward_with_lane_1_on_the_left(tmp_path, carriageway):
    found, wanted = read_tracks(highd(tmp_path, carriageway)), plain(tmp_path, two())
    for name, track in wanted.tracks.items():
        np.testing.assert_allclose(found.tracks[name].x, track.x, atol=1e-9)
        np.testing.assert_allclose(found.tracks[name].y, track.y, atol=1e-9)


def without(key):
    return [{k: v for k, v in row.items() if k != key} for row in two()]


def changed(index, **values):
    table = two()
    table[index] = table[index] | values
    return table


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (without("length_m"), "got none named length_m"),
        ([{("x_ft" if k == "x_m" else k): v for k, v in r.items()} for r in two()], "got none named x_m"),
        (two()[:5] + two()[6:], "got a gap of vehicle 1 from 0.4 to 0.6 s"),
        ([*two(), two()[3]], "got two of 1 at 0.3 s"),
        (two() + rows(name="1", start=60.0), "got two of 1 at 0 s"),
        (rows(3), "too short"),
        (changed(4, x_m="abc"), "got 'abc' in row 5"),
        (changed(4, x_m="nan"), "got 'nan' in row 5"),
        (changed(4, x_m=500.0), "got 497.0 m of 1 after 0.3 s"),
        (changed(4, y_m=5.0), "off it"),
        ([row | {"speed_mps": 36.0} for row in two()], "recorded speeds must fit the positions"),
        ([row | {"width_m": 0.0} for row in two()], "a length and a width above 0"),
    ],
)  # fmt: skip
def test_mistakes_are_refused_in_one_line(tmp_path, table, words):
    line = refusal(lambda: plain(tmp_path, table))
    assert words in line
    assert "t.csv" in line


def test_what_is_beside_the_road_is_left_out_where_that_is_asked_for(tmp_path):
    table = two() + rows(name="3", y=9.0)
    assert "3 at 0 s" in refusal(lambda: plain(tmp_path, table))
    traffic = plain(tmp_path, table, off_road="leave_out")
    assert set(traffic.tracks) == {"1", "2"}
    assert traffic.notes == ("1 vehicles of the record are never on the road, and left out",)
    assert set(plain(tmp_path, table, leave_out=("3",)).tracks) == {"1", "2"}
