"""A study whose seeds cannot give a verdict says so before it runs."""

import pytest

from sumo_hmdp.report.study_seeds import shortfalls
from sumo_hmdp.study.design import load_design

STUDY = """
name: few
scenarios: [case2]
factors:
  planner: [hmdp_mpc, idm_mobil]
  risk_level: [0.05]
seeds: {{first: 0, count: {count}}}
trace: {trace}
"""


@pytest.fixture
def told(tmp_path):
    def of(count, trace="all"):
        file = tmp_path / "study.yaml"
        file.write_text(STUDY.format(count=count, trace=trace))
        return shortfalls(load_design(file))

    return of


def test_with_hardly_any_seeds_nothing_can_be_shown(told):
    difference, risk = told(5)
    assert difference == "no difference between cells can be shown with 5 seeds; it takes 6 at least"
    assert risk.startswith("a risk level of 0.05 cannot be shown to be kept with 5 seeds, even without any violation")
    assert "it takes 72 at least, and 146 to be called conservative" in risk


def test_contacts_take_more_seeds_than_means(told):
    # Eight comparisons: z of 0.05 / 16 is 2.734, its square 7.5.
    (sentence,) = told(7, "none")
    assert sentence == (
        "no difference in the rate of contacts can be shown with 7 seeds after Holm's correction for the 8 comparisons "
        "of the report; it takes 8 at least"
    )
    assert told(8, "none") == ()


def test_with_seeds_enough_nothing_is_said(told):
    assert len(told(71)) == 1
    assert told(72) == ()
