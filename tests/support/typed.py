"""What a test knows and types do not say: a value is there, a model has the fields that are read."""

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

from pydantic import BaseModel

Given = ParamSpec("Given")
Model = TypeVar("Model", bound=BaseModel)
Value = TypeVar("Value")


def present(value: Value | None) -> Value:
    """The value; the test fails if it is None."""
    assert value is not None
    return value


def model_of(kind: type[Model], **fields: Any) -> Model:
    """A model that has these fields and the defaults alone: a test that reads another one fails there."""
    return kind.model_construct(**fields)


def noted(function: Callable[Given, Value], calls: list[Any]) -> Callable[Given, Value]:
    """The function; the positional arguments of each call are put into `calls` first."""

    def noting(*given: Given.args, **named: Given.kwargs) -> Value:
        calls.append(given)
        return function(*given, **named)

    return noting
