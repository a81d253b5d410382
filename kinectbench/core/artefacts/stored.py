"""Base of all stored JSON files: writes a typed value to a file and reads it back.

Inside the package every length is in metres and every angle in radians, and unknown values are None. In the
files some keys are in millimetres or degrees, for people who open them. A field always has the unit and the
name of its value in memory. The model `ScaledPart` makes the key: `shift_m: MillimetresInFile` is `shift_mm`.
"""

import math
import re
from collections.abc import Callable
from numbers import Integral, Real
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    FailFast,
    Field,
    GetCoreSchemaHandler,
    PlainSerializer,
    SerializerFunctionWrapHandler,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    WithJsonSchema,
    model_serializer,
    model_validator,
)
from pydantic_core import CoreSchema
from pydantic_core.core_schema import DictSchema, ListSchema, TupleSchema

from kinectbench.core.errors import KinectBenchError, StorageError, pydantic_message
from kinectbench.core.storage import pretty_json
from kinectbench.core.types import Float64
from kinectbench.core.untrusted import printable, read_plain_text
from kinectbench.core.untrusted_text import MOST_TEXT, MOST_VALUES, long_text, strict_json

# Limit of one file's size: 32 bytes for each value that it may have.
JSON_BYTES = 64 << 20
# Largest number of a file's errors that are written out as Python values, a kilobyte each.
MOST_ERRORS = 1000
# pydantic copies an object for each key that it lacks: in a longer text the first is looked for beforehand
# (chosen here; forty copies of it are 40 MB of text).
LONG_TEXT = 1 << 20

# What can be left at its first wrong entry; mappings since pydantic 2.13.
EARLY = [
    kind
    for kind, schema in (("tuple", TupleSchema), ("list", ListSchema), ("dict", DictSchema))
    if "fail_fast" in schema.__annotations__
]


def _leave_early(schema: object) -> None:
    """Set pydantic's `fail_fast` in all lists, tuples and mappings of a core schema."""
    if isinstance(schema, list):
        for part in schema:
            _leave_early(part)
    elif isinstance(schema, dict):
        if schema.get("type") in EARLY:
            schema["fail_fast"] = True
        for part in schema.values():
            _leave_early(part)


class StoredPart(BaseModel):
    """A part of a stored file: frozen, without NaN or infinity; unknown keys are kept.

    Newer versions may write more keys, and these must survive if a file is read and written again. No keys
    are added: a key whose default is None or () is written only if it was given (null counts).
    """

    model_config = ConfigDict(
        frozen=True,
        extra="allow",
        allow_inf_nan=False,
        validate_by_name=True,
        validate_by_alias=False,
        serialize_by_alias=True,
        arbitrary_types_allowed=True,
    )

    @classmethod
    def __get_pydantic_core_schema__(cls, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Pydantic's schema; validation of lists and mappings stops at the first error, to save memory."""
        schema = handler(source)
        _leave_early(schema)
        return schema

    # A return type would take the place of the model's JSON schema in mode "serialization".
    @model_serializer(mode="wrap")
    def _without_absent_keys(self, to_dict: SerializerFunctionWrapHandler):  # type: ignore[no-untyped-def]
        values = to_dict(self)
        for name, field in type(self).model_fields.items():
            if name not in self.model_fields_set and field.default in (None, ()):
                values.pop(field.alias or name, None)
        return values

    def json_value(self) -> dict[str, Any]:
        """The plain JSON object, with the keys and units of the file; keys in the order of the fields."""
        return self.model_dump(mode="json")


class Stored(StoredPart):
    """A whole JSON file.

    Attributes:
        FILE: name of the file, relative to its folder.
        ADVICE: what an error advises if the file is damaged.
        ERROR: the exception for a missing or damaged file.
        MAX_BYTES: a larger file is refused before it is read, because files are untrusted.
        MAX_VALUES: a file with more JSON values is refused, too.
        MAX_TEXT: so is a file in which a text or a key has more characters.
    """

    FILE: ClassVar[str]
    ADVICE: ClassVar[str] = "`kinectbench build --force` makes it again"
    ERROR: ClassVar[type[KinectBenchError]] = StorageError
    MAX_BYTES: ClassVar[int] = JSON_BYTES
    MAX_VALUES: ClassVar[int] = MOST_VALUES
    MAX_TEXT: ClassVar[int] = MOST_TEXT

    def text(self) -> str:
        """Return the JSON text of the file."""
        return pretty_json(self.json_value())

    def write(self, folder: Path) -> None:
        """Write the file into an existing folder."""
        (folder / self.FILE).write_text(self.text(), encoding="utf-8")

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Read the file in a folder; raises what `read_file` raises."""
        return cls.read_file(folder / cls.FILE)

    @classmethod
    def read_file(cls, path: Path) -> Self:
        """Read a file of this kind, whatever its name is.

        Raises:
            KinectBenchError: `cls.ERROR`, if the file is missing, too large, damaged or of another kind.
        """
        try:
            text = read_plain_text(path, cls.MAX_BYTES)
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or error
            problem = "missing" if isinstance(error, FileNotFoundError) else f"cannot be read ({reason})"
            raise cls.ERROR(f"{path}: {problem}; {cls.ADVICE}") from error
        return cls.parse(text, str(path))

    @classmethod
    def read_if_there(cls, folder: Path) -> Self | None:
        """Read the file in a folder; None if there is no such file."""
        return cls.read(folder) if (folder / cls.FILE).is_file() else None

    @classmethod
    def parse(cls, text: str, where: str) -> Self:
        """Parse the text of a file of this kind; types are strict: a number written as text is refused.

        Args:
            text: JSON.
            where: start of the error message, such as the path.

        Raises:
            KinectBenchError: `cls.ERROR`, in one line that names the first key that is wrong.
        """
        try:
            content = strict_json(text, cls.MAX_VALUES)
            if len(text) > cls.MAX_TEXT and (problem := long_text(text, cls.MAX_TEXT)):
                raise cls.ERROR(f"{where}: {problem}", what="too-large")
            if len(text) > LONG_TEXT and (missing := cls._missing(content)):
                raise cls.ERROR(f"{where}: '{missing}': Field required; {cls.ADVICE}")
            return cls.validated(text)
        except ValidationError as error:
            if error.error_count() > MOST_ERRORS:
                problem = f"{error.error_count()} values are not as they should be"
                raise cls.ERROR(f"{where}: {problem}; {cls.ADVICE}") from error
            first = error.errors(include_input=False)[0]
            key = ".".join(str(part) for part in first["loc"])
            why = pydantic_message(first)
            problem = f"'{printable(key)}': {printable(why, 200)}" if key else why
            raise cls.ERROR(f"{where}: {problem}; {cls.ADVICE}") from error
        except (ValueError, RecursionError) as error:
            raise cls.ERROR(f"{where}: not valid JSON ({error}); {cls.ADVICE}") from error

    @classmethod
    def _missing(cls, content: object) -> str:
        """Return the first required key that an object lacks, or ""."""
        keys = (field.alias or name for name, field in cls.model_fields.items() if field.is_required())
        return next((key for key in keys if isinstance(content, dict) and key not in content), "")

    @classmethod
    def validated(cls, text: str) -> Self:
        """Parse JSON like `parse`, but without its limits on the JSON; raises pydantic's ValidationError."""
        return cls.model_validate_json(text, strict=True, by_alias=True, by_name=False)


class Bare(Stored):
    """A whole file that holds only the value of the model's one field, such as a list of rows."""

    @classmethod
    def _missing(cls, content: object) -> str:
        return ""

    @classmethod
    def validated(cls, text: str) -> Self:
        """Parse the whole text as the value of the model's one field."""
        ((name, field),) = cls.model_fields.items()
        early: Any = Annotated[field.rebuild_annotation(), FailFast()]
        kind: TypeAdapter[object] = TypeAdapter(early)
        value = kind.validate_json(text, strict=True, by_alias=True, by_name=False)
        return cls(**{name: value})

    @model_serializer(mode="wrap")
    def _without_absent_keys(self, to_dict: SerializerFunctionWrapHandler) -> object:
        (value,) = to_dict(self).values()
        return value


def optional(description: str) -> Any:
    """Declare a key that may be missing or null; the value is then None."""
    return Field(None, description=description)


def known(value: float | np.floating[Any], decimals: int | None = None) -> float | None:
    """Convert a number for a model: None for NaN or infinity, else a float, rounded on request."""
    if not np.isfinite(value):
        return None
    return float(value) if decimals is None else round(float(value), decimals)


def number(value: float | None) -> float:
    """Return the inverse of `known`: NaN for None, as JSON has no NaN and no infinity."""
    return math.nan if value is None else value


def _scaled_in_file(factor: float, decimals: int) -> tuple[object, ...]:
    """Annotations of a number that is multiplied by `factor` and rounded to `decimals` in the file.

    The value in memory is rounded accordingly, so that it equals the value that is read back.
    """

    def from_file(value: object, info: ValidationInfo) -> object:
        return value / factor if info.mode == "json" and isinstance(value, int | float) else value

    def as_in_file(value: float) -> float:
        return round(value * factor, decimals)

    return (
        BeforeValidator(from_file),
        AfterValidator(lambda value: as_in_file(value) / factor),
        PlainSerializer(as_in_file, return_type=float),
    )


def must(what: str, is_so: Callable[[Any], bool]) -> AfterValidator:
    """Return a validator that raises ValueError("must " + what) for a value that `is_so` rejects."""

    def checked(value: object) -> object:
        if not is_so(value):
            raise ValueError(f"must {what}")
        return value

    return AfterValidator(checked)


# Numbers that files state, untrusted: a sum of shares may be above 1 by rounding.
ROUNDING = 1e-9
Share = Annotated[float, must("be a share from 0 to 1", lambda x: -ROUNDING <= x <= 1 + ROUNDING)]
NotNegative = Annotated[float, must("not be negative", lambda x: x >= -ROUNDING)]
Count = Annotated[int, must("not be negative", lambda n: n >= 0)]
# Metres in memory, millimetres to a hundredth in the file.
MillimetresInFile = Annotated[float, *_scaled_in_file(1000.0, 2)]
# Seconds in memory, milliseconds to a hundredth in the file; the key is an alias of the field's own.
MillisecondsInFile = Annotated[float, *_scaled_in_file(1000.0, 2)]
# Radians in memory, degrees to a hundredth in the file.
DegreesInFile = Annotated[float, *_scaled_in_file(180.0 / np.pi, 2)]


class ScaledPart(StoredPart):
    """A part whose lengths in metres and angles in radians are in millimetres and degrees in the file.

    A field `x_m` has the key `x_mm`, and `x_rad` the key `x_deg`, unless it has an alias of its own. Only
    JSON uses these keys: code must pass a value by the field's name.
    """

    model_config = ConfigDict(
        validate_by_name=True,
        alias_generator=lambda name: re.sub("_rad$", "_deg", re.sub("_m$", "_mm", name)),
    )

    @model_validator(mode="after")
    def _by_names_in_memory(self, info: ValidationInfo) -> Self:
        if info.mode == "python" and self.model_extra:
            keys = {field.alias for field in type(self).model_fields.values()}.intersection(self.model_extra)
            if keys:
                raise ValueError(f"{', '.join(map(str, keys))}: in the units of the file, not of memory")
        return self


def array_in_file(shape: tuple[int, ...], dtype: type = np.float64) -> tuple[object, ...]:
    """Return annotations for a field with an array of this shape and type; in the file, it is nested lists.

    Texts, booleans, NaN and infinity are refused, and for an integer `dtype` also floats.
    """
    number_type = Integral if np.issubdtype(dtype, np.integer) else Real

    def checked(value: object) -> NDArray[np.generic]:
        """Convert a value to a read-only array; ValueError for another shape, or values that are refused."""
        refusal = ValueError(f"must be {' x '.join(map(str, shape))} finite numbers")
        # Numpy would take texts and booleans for numbers.
        given = np.array(value, dtype=object)
        if any(not isinstance(one, number_type) or isinstance(one, bool) for one in given.flat):
            raise refusal
        try:
            array: NDArray[np.generic] = given.astype(dtype)
        except OverflowError as error:
            raise refusal from error
        if array.shape != shape or not np.isfinite(array).all():
            raise refusal
        array.flags.writeable = False
        return array

    schema: dict[str, object] = {"type": "number"}
    for side in reversed(shape):
        schema = {"type": "array", "items": schema, "minItems": side, "maxItems": side}
    return (
        BeforeValidator(checked),
        PlainSerializer(lambda array: array.tolist(), return_type=list),
        WithJsonSchema(schema),
    )


Matrix3 = Annotated[Float64, *array_in_file((3, 3))]
Matrix4 = Annotated[Float64, *array_in_file((4, 4))]
Vector4 = Annotated[Float64, *array_in_file((4,))]
