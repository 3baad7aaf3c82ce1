"""Reading files: YAML means what JSON means, and no key gets lost."""

import os
import time
import tracemalloc

import pytest

from sumo_hmdp.documents import BYTES_MAX, DEPTH_MAX, read_json, read_yaml
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


def test_an_alias_of_itself_is_a_mistake(yaml_of):
    with pytest.raises(InputError, match=r"a\.yaml: a\[0\]: must not hold itself, got \*a at line 1"):
        yaml_of("a: &a [*a]")


def test_a_list_as_a_key_is_a_mistake(yaml_of):
    with pytest.raises(InputError, match="must have texts as keys, got a list, mapping or alias at line 1"):
        yaml_of("[1, 2]: 3")


def test_json_with_keys_that_stand_twice(tmp_path):
    (tmp_path / "a.json").write_text('{"a": [{"b": 1, "b": {"c": 1, "c": 2}}], "d": [1, 2]}')
    document = read_json(tmp_path / "a.json")
    assert document.content == {"a": [{"b": {"c": 2}}], "d": [1, 2]}
    assert [problem.path for problem in document.problems] == ["a[0].b", "a[0].b.c"]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("yes", True), ("Off", False), ("~", None), ("", None), ("NULL", None), ("+3", 3), ("-0", 0), ("1.", 1.0),
        ("007.5", 7.5), (".inf", float("inf")), ("-.INF", float("-inf")), ("1e999", float("inf")), ("e", "e"),
        ("9" * 5000, float("inf")), ("!!str 5", "5"), ("!!float 5", 5.0), ("!!int '5'", 5), ("!!bool 'no'", False),
        ("! 5", 5), ("12:30 h", "12:30 h"), ("'017'", "017"), ("=", "="),
    ],
)  # fmt: skip
def test_scalars_mean_what_they_say(yaml_of, text, value):
    found = yaml_of(f"a: {text}").content["a"]
    assert (found, type(found)) == (value, type(value))


@pytest.mark.parametrize(
    "text", ["017", "0o17", "0x1F", "0b11", "1:30", "1:30.5", "1_000", "1_0.5", "2020-01-02", "2020-13-45"]
)
def test_what_versions_of_yaml_read_differently_is_a_mistake(yaml_of, text):
    with pytest.raises(InputError) as caught:
        yaml_of(f"b: 1\na: {text}")
    (line,) = caught.value.lines()
    assert f"a: must mean the same in all versions of YAML, got {text!r} at line 2. Quote a text" in line


LAUGHS = "a0: &a0 [x,x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"a{n}: &a{n} [{','.join([f'*a{n - 1}'] * 10)}]\n" for n in range(1, 9)
)
# What each file is, and the only line that it gets.
HOSTILE = {
    "control character": ("a: \x1b[31m", "must be text without control characters, got U.001B at line 1"),
    "NUL": ("name: a\0b", "must be text without control characters, got U.0000 at line 1"),
    "C1 control": ("a:\n  \x9b31m", "must be text without control characters, got U.009B at line 2"),
    "escaped control": (r'a: "\0x"', r"a: must be text without control characters, got '.x00x'. Remove it"),
    "half a pair": (r'a: "\uD800"', "must be YAML: found invalid Unicode character escape code at line 1"),
    "no truth": ("a: !!bool maybe", "a: must be what its tag !!bool says, got 'maybe' at line 1"),
    "no number": ('a: !!int ""', "a: must be what its tag !!int says, got '' at line 1"),
    "no float": ("a: !!float abc", "a: must be what its tag !!float says, got 'abc' at line 1"),
    "not null": ("a: !!null x", "a: must be what its tag !!null says"),
    "timestamp": ("a: !!timestamp x", "a: must have no tag but .*, got '!!timestamp' at line 1"),
    "binary": ("a: !!binary aGk=", "a: must have no tag but .*, got '!!binary'"),
    "set": ("a: !!set {x, y}", "a: must have no tag but !!map, got '!!set'"),
    "pairs": ("a: !!omap [x: 1]", "a: must have no tag but !!seq, got '!!omap'"),
    "python": ("a: !!python/object/apply:os.system [x]", "a: must have no tag but .*, got '!!python/object"),
    "own tag": ("a: !mine x", "a: must have no tag but .*, got '!mine' at line 1"),
    "tagged key": ("? !!binary aGk=\n: 1", "must have no tag but .*, got '!!binary' at line 1"),
    "hex": ("a: 0x" + "F" * 6000, "a: must mean the same in all versions of YAML, got '0xF"),
    "nesting": ("[" * 600 + "]" * 600, f"must be nested at most {DEPTH_MAX} deep"),
    "block nesting": ("\n".join("  " * n + "a:" for n in range(600)), f"must be nested at most {DEPTH_MAX} deep"),
    "open brackets": ("[" * 1_000_000, f"must be nested at most {DEPTH_MAX} deep"),
    "aliases": (LAUGHS, "must hold at most 50,000 values"),
    "values": ("- x\n" * 900_000, "must hold at most 50,000 values"),
    "merges": (
        "a: &a {" + "x: 1, y: 2, " * 1000 + "}\nb:\n" + "- {<<: *a}\n" * 1000,
        "must hold at most 50,000 values",
    ),
    "merge of a text": ("a: {<<: x}", "a.<<: must merge mappings, got 'x'"),
    "itself in a merge": ("a: &a {<<: *a}", "a.<<: must not hold itself, got .a at line 1"),
    "no anchor": ("a: *b", "must be YAML: found undefined alias 'b' at line 1"),
    "alias as a key": ("a: &a x\n*a : 1", "must have texts as keys, got a list, mapping or alias at line 2"),
    "two documents": ("a: 1\n---\nb: 1", "must be one document, got another at line 2"),
    "tab": ("\ta: 1", "must be YAML: found character that cannot start any token at line 1"),
    "size": ("#" * (BYTES_MAX + 1), "must be at most 4 MB, got 4.0 MB"),
}


@pytest.mark.parametrize("what", HOSTILE)
def test_hostile_yaml_is_one_line_in_no_time(yaml_of, what):
    text, message = HOSTILE[what]
    _one_line_in_no_time(lambda: yaml_of(text), message)


def _one_line_in_no_time(read, message):
    tracemalloc.start()
    started = time.process_time()
    try:
        with pytest.raises(InputError, match=message) as caught:
            read()
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert len(caught.value.lines()) == 1
    assert len(str(caught.value)) < 500
    # Memory is traced, which takes most of the time.
    assert time.process_time() - started < 8.0
    assert peak < 200e6


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 600 + "]" * 600, f"must be nested at most {DEPTH_MAX} deep"),
        ("[" * 2_000_000, "must be JSON of a reasonable size: nested at most 50 deep"),
        ('{"a":' * 600 + "1" + "}" * 600, f"must be nested at most {DEPTH_MAX} deep"),
        ("[" + "[]," * 1_000_000 + "[]]", "must hold at most 50,000 values"),
        (r'{"a": "x\u0000"}', "a: must be text without control characters, got 'x.x00'"),
        (r'{"a\u001b": 1}', r"a.x1b: must be text without control characters"),
        (r'{"a": ["\ud800"]}', r"a\[0\]: must be text without halves of a surrogate pair"),
        ('{"a": "\x07"}', "must be text without control characters, got U.0007 at line 1"),
        ("{} {}", "must be JSON: Extra data at line 1"),
        ("{'a': 1}", "must be JSON: .* at line 1, column 2"),
    ],
    ids=range(10),
)
def test_hostile_json_is_one_line_in_no_time(tmp_path, text, message):
    (tmp_path / "a.json").write_text(text, encoding="utf-8")
    _one_line_in_no_time(lambda: read_json(tmp_path / "a.json"), message)


def test_a_pair_of_surrogates_is_a_letter_and_a_long_numeral_is_infinite(tmp_path):
    (tmp_path / "a.json").write_text(r'["\ud83d\ude97", ' + "9" * 5000 + ", -" + "9" * 5000 + ", 1e999, NaN]")
    letter, *numbers, nan = read_json(tmp_path / "a.json").content
    assert (letter, numbers) == ("\U0001f697", [float("inf"), float("-inf"), float("inf")])
    assert nan != nan


@pytest.mark.parametrize("read", [read_json, read_yaml])
def test_what_is_no_file_is_not_waited_for(tmp_path, read):
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", "/dev/zero", tmp_path, tmp_path / "no", tmp_path / ("x" * 5000), tmp_path / "a\0b"):
        with pytest.raises(InputError, match="cannot be read: ") as caught:
            read(type(tmp_path)(path))
        assert len(caught.value.lines()) == 1


@pytest.mark.parametrize("data", ["a: 1".encode("utf-16"), "a: 1".encode("utf-16-le"), b"a: \xff"])
def test_other_encodings_are_one_line(tmp_path, data):
    (tmp_path / "a.yaml").write_bytes(data)
    with pytest.raises(InputError, match=r"must be UTF-8 text|without control characters"):
        read_yaml(tmp_path / "a.yaml")


def test_a_mark_of_utf_8_and_line_ends_of_windows_are_read(tmp_path):
    (tmp_path / "a.yaml").write_bytes(b"\xef\xbb\xbfa: 1\r\nb:\tx\r\n")
    assert read_yaml(tmp_path / "a.yaml").content == {"a": 1, "b": "x"}
