"""JSON and CSV of strangers: what a text becomes is bounded, one below and one above each bound."""

import json
import math

import pytest

from kinectbench.core.untrusted_text import (
    MOST_KEYS,
    MOST_VALUES,
    csv_rows,
    parsed_json,
    strict_json,
)


def test_json() -> None:
    values = {"a": [1, 2.5, None, True, "σ 🪑"], "": {}}
    assert strict_json(json.dumps(values)) == values
    for wrong in ("", "[", "NaN", "[-Infinity]", '{"a": Infinity}', "[1] 2", "1" * 5000):
        with pytest.raises(ValueError, match=r"line 1|is not JSON|4300 digits"):
            strict_json(wrong)
    assert math.isnan(parsed_json("[NaN, Infinity]", constants=True)[0])


def test_a_key_that_is_there_twice() -> None:
    for twice in ('{"a": 1, "b": 2, "a": 1}', '[{"x": {"b": 1, "a": 1, "a\\u0000": 2, "a": 3}}]'):
        with pytest.raises(ValueError, match="it has the key 'a' twice"):
            strict_json(twice)
        parsed_json(twice, constants=True)
    assert strict_json('{"a": {"a": 1}, "A": 2}') == {"a": {"a": 1}, "A": 2}


def test_as_many_values_as_are_accepted_and_one_more() -> None:
    most = "[" + "1," * (MOST_VALUES - 1) + "1]"
    assert len(strict_json(most)) == MOST_VALUES
    with pytest.raises(ValueError, match="more than 2000000 values"):
        strict_json(f"[1,{most[1:]}")


def test_as_many_keys_as_are_accepted_and_one_more() -> None:
    text = "{" + ",".join(f'"{n}":0' for n in range(MOST_KEYS)) + "}"
    assert len(strict_json(text)) == MOST_KEYS
    with pytest.raises(ValueError, match="more than 300000 keys"):
        strict_json(f'{{"more":{text}}}')


def test_csv_of_as_many_values_as_are_accepted_and_one_more() -> None:
    assert csv_rows("a,b\r\nc,d\n") == [["a", "b"], ["c", "d"]]
    assert len(csv_rows("1," * MOST_VALUES)[0]) == MOST_VALUES + 1
    with pytest.raises(ValueError, match="more than 2000000 values"):
        csv_rows("1," * (MOST_VALUES + 1))
    with pytest.raises(ValueError, match="field"):
        csv_rows("a" * 200_000)
