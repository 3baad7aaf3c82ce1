"""Reading files: YAML means what JSON means, and no key gets lost."""

import pytest

from sumo_hmdp.documents import read_json, read_yaml
from sumo_hmdp.errors import InputError, Problem


@pytest.fixture
def yaml_of(tmp_path):
    def read(text):
        (tmp_path / "a.yaml").write_text(text, encoding="utf-8")
        return read_yaml(tmp_path / "a.yaml")

    return read


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-5", 1e-5),
        ("1.5E3", 1500.0),
        ("-2e0", -2.0),
        ("1.0e-5", 1e-5),
        ("3", 3),
        (".5", 0.5),
        ("e5", "e5"),
        ("'1e-5'", "1e-5"),
    ],
)
def test_numbers_are_those_of_json(yaml_of, text, value):
    content = yaml_of(f"a: {text}").content
    assert content == {"a": value}
    assert type(content["a"]) is type(value)


def test_keys_are_texts_as_written(yaml_of):
    assert yaml_of("{1: a, yes: b, 2.0: c, null: d}").content == {"1": "a", "yes": "b", "2.0": "c", "null": "d"}


def test_keys_that_stand_twice_are_found_wherever_they_are(yaml_of):
    document = yaml_of("a: 1\nb:\n  - c: 1\n    c: 2\na: 3\n1: x\n'1': y\n")
    assert document.problems == (
        Problem("b[0].c", "must stand once, got it again at line 4. Remove one"),
        Problem("a", "must stand once, got it again at line 5. Remove one"),
        Problem("1", "must stand once, got it again at line 7. Remove one"),
    )


def test_a_merge_may_be_overruled(yaml_of):
    document = yaml_of("a: &a {x: 1, y: 2}\nb: {<<: *a, x: 3}\n")
    assert document.problems == ()
    assert document.content["b"] == {"x": 3, "y": 2}


def test_an_alias_of_itself_ends(yaml_of):
    content = yaml_of("a: &a [*a]").content
    assert content["a"][0] is content["a"]


def test_a_list_as_a_key_is_a_mistake(yaml_of):
    with pytest.raises(InputError, match="must be YAML: found unhashable key at line 1"):
        yaml_of("[1, 2]: 3")


def test_json_with_keys_that_stand_twice(tmp_path):
    (tmp_path / "a.json").write_text('{"a": [{"b": 1, "b": {"c": 1, "c": 2}}], "d": [1, 2]}')
    document = read_json(tmp_path / "a.json")
    assert document.content == {"a": [{"b": {"c": 2}}], "d": [1, 2]}
    assert [problem.path for problem in document.problems] == ["a[0].b", "a[0].b.c"]
