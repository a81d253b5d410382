"""Every error has a code that the table of errors lists; the code survives pickling."""

import ast
import errno
import pickle
from pathlib import Path

import pytest
from error_codes import ERROR_CODES, KINDS
from raising import raises

from kinectbench.core.errors import (
    TOO_LONG,
    KinectBenchError,
    RecordingError,
    SettingsError,
    error_code,
    internal_error,
)

ROOT = Path(__file__).parents[2]
TREES = [ast.parse(path.read_text(encoding="utf-8")) for path in sorted((ROOT / "kinectbench").rglob("*.py"))]
BASE = KinectBenchError.__name__


def kinds(trees: list[ast.Module]) -> dict[str, tuple[str, str]]:
    """Each class of errors, with the kind of its codes and the code's second half of its own."""
    found = {BASE: (KinectBenchError.kind, KinectBenchError.what)}
    classes = [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    for _ in range(4):  # no class of errors has more above it
        for node in classes:
            above = [found[name] for base in node.bases if (name := ast.unparse(base)) in found]
            if above:
                kind, what = above[0]
                for line in node.body:
                    if isinstance(line, ast.Assign):
                        names, value = ast.unparse(line.targets[0]), ast.literal_eval(line.value)
                        kind, what = {"(kind, what)": value, "what": (kind, value)}.get(names, (kind, what))
                found[node.name] = (kind, what)
    return found


def codes(trees: list[ast.Module]) -> set[str]:
    """The codes of all errors that are made; of a class that is not known by its name, those of all kinds."""
    of_class = kinds(trees)
    made = {f"{kind}.{what}" for kind, what in of_class.values()}
    for call in (node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Call)):
        name = ast.unparse(call.func)
        what = next((word.value for word in call.keywords if word.arg == "what"), None)
        if name in of_class and isinstance(what, ast.Constant) and isinstance(what.value, str):
            made.add(f"{of_class[name][0]}.{what.value}")
    return made


# Made elsewhere: of what Python raises, of a process that was killed, and of the types of pydantic's errors.
OTHERS = {
    *("run.internal-error", "run.no-memory", "run.process-killed"),
    *("settings.unknown-key", "settings.missing-key", "storage.not-fetched"),
}


def test_the_table_has_the_codes_of_all_errors_and_no_others() -> None:
    found = codes(TREES) | OTHERS
    assert sorted(found - set(ERROR_CODES)) == [], "list them in scripts/error_codes.py"
    assert sorted(set(ERROR_CODES) - found) == [], "no error has these codes"


def test_the_codes_of_errors_are_found() -> None:
    text = 'class OddError(ReleaseError):\n    what = "odd"\n\nraise OddError(f"a {b}", what="even")\n'
    text = f'class ReleaseError({BASE}):\n    kind, what = "release", "damaged"\n\n{text}f(what="no")\n'
    assert codes([ast.parse(text)]) == {"run.failed", "release.damaged", "release.odd", "release.even"}


def test_codes_are_of_a_kind_and_in_order() -> None:
    assert {code.split(".")[0] for code in ERROR_CODES} == set(KINDS)
    order = [(list(KINDS).index(code.split(".")[0]), code) for code in ERROR_CODES]
    assert order == sorted(order)
    assert [text for text in ERROR_CODES.values() if text[-1] != "." or "; " not in text] == []


def test_the_page_lists_them() -> None:
    from docs_errors import page

    assert page() == (ROOT / "docs" / "errors.md").read_text(encoding="utf-8"), "run scripts/docs_errors.py"


def test_an_error_keeps_its_code_where_it_is_pickled() -> None:
    for error in (SettingsError("a", "b", what="bad-url"), RecordingError("c")):
        again = pickle.loads(pickle.dumps(error))
        assert (type(again), again.lines, again.code) == (type(error), error.lines, error.code)


def test_another_code_is_not_taken_for_it() -> None:
    with (
        pytest.raises(AssertionError, match="bad-url: a"),
        raises(SettingsError, "settings.no-file"),
    ):
        raise SettingsError("a", what="bad-url")


def test_any_error_has_a_code() -> None:
    codes = [error_code(error) for error in (SettingsError("a"), MemoryError(), KeyError("a"))]
    assert codes == ["settings.wrong-value", "run.no-memory", "run.internal-error"]


def test_a_meaning_that_its_code_says_is_left_out() -> None:
    from docs_errors import page

    text = page()
    assert "- `segmentation.no-floor`, `segmentation.no-masks`, `segmentation.no-object`\n" in text
    assert "- `storage.no-room`: There is not enough free space.\n" in text
    assert [code for code in ERROR_CODES if f"`{code}`" not in text] == []


def test_a_long_name_is_printed_shortened_and_safe() -> None:
    said = internal_error(OSError(errno.ENAMETOOLONG, "", "\x1b[31mred\n" + 300 * "x"))
    assert said.startswith("?[31mred?xx") and said.endswith(f"xx: {TOO_LONG}")
    assert len(said) == 80 + len(f": {TOO_LONG}")
    assert internal_error(OSError(errno.ENAMETOOLONG, "")) == TOO_LONG
