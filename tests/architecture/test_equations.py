"""Docstrings cite equations of docs/formulation.md: each must be there, and each must be computed somewhere."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FORMULATION = (ROOT / "docs" / "formulation.md").read_text(encoding="utf-8")
NUMBERED = set(re.findall(r"\s\((\d+)[a-z]?\)\s*$", FORMULATION, re.MULTILINE))
# A range such as "eqs. 4 to 6" cites its ends and what is between; "eqs. 12 and 13" cites both.
CITATION = re.compile(r"eqs?\.\s+(\d+)[a-z]?(?:\s*(,|to|and)\s+(\d+)[a-z]?)?")


def cited(text):
    numbers = set()
    for first, word, second in CITATION.findall(text):
        low = int(first)
        high = int(second) if second else low
        numbers |= {low, high} if word != "to" else set(range(low, high + 1))
    return {str(number) for number in numbers}


SOURCES = sorted((ROOT / "sumo_hmdp").rglob("*.py"))


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_cited_equations_exist(path):
    assert cited(path.read_text(encoding="utf-8")) <= NUMBERED


def test_every_equation_is_cited_where_it_is_computed():
    everywhere = set().union(*(cited(path.read_text(encoding="utf-8")) for path in SOURCES))
    assert {str(number) for number in range(1, 47)} == NUMBERED
    assert NUMBERED - everywhere == set()
