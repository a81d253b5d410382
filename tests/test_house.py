"""The size of the package's rooms, files and functions: what keeps it readable in the large."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "kinectbench"
TESTS = Path(__file__).parent
FILES = {
    path.relative_to(PACKAGE).as_posix(): path.read_text(encoding="utf-8")
    for path in sorted(PACKAGE.rglob("*.py"))
}
# Of what numba compiles; a kernel cannot be cut up freely without losing speed.
COMPILED = ("njit", "jit", "vectorize", "guvectorize")


@cache
def parsed(text: str) -> ast.Module:
    """Each file once for all tests."""
    return ast.parse(text)


def holds_the_lock(text: str) -> list[str]:
    """What computes without giving Python's lock back: kernels without nogil, and rows that are sorted."""
    found = []
    for call in ast.walk(parsed(text)):
        if not isinstance(call, ast.Call):
            continue
        name = ast.unparse(call.func)
        given = {word.arg: ast.unparse(word.value) for word in call.keywords}
        compiled = name.split(".")[-1] in COMPILED and given.get("nogil") != "True"
        if compiled or (name == "np.unique" and "axis" in given):
            found.append(ast.unparse(call))
    bare = (node for node in ast.walk(parsed(text)) if isinstance(node, ast.FunctionDef))
    found += [
        f"@{name}"
        for node in bare
        for name in map(ast.unparse, node.decorator_list)
        if name.split(".")[-1] in COMPILED
    ]
    return found


def test_no_signal_waits_for_what_computes() -> None:
    """`engine.interrupts` ends a process that computes only if that gives Python's lock back.

    Meshes of the lab are not as large as the recordings that the other rooms work on.
    """
    found = {name: calls for name, text in FILES.items() if (calls := holds_the_lock(text))}
    assert {name: calls for name, calls in found.items() if not name.startswith("lab/")} == {}
    assert [call for calls in found.values() for call in calls if "jit" in call] == []


def test_what_holds_the_lock_is_found() -> None:
    bad = "@njit\ndef f(): pass\n@numba.njit(cache=True)\ndef g(): pass\nnp.unique(cells, axis=0)\n"
    good = "@numba.njit(cache=True, nogil=True)\ndef f(): pass\nnp.unique(numbers)\n"
    assert len(holds_the_lock(bad)) == 3 and holds_the_lock(good) == []


def test_at_most_twelve_rooms() -> None:
    rooms = {name.split("/")[0] for name in FILES if "/" in name}
    assert len(rooms) <= 12, sorted(rooms)


def test_no_file_is_over_400_lines() -> None:
    tests = {
        f"tests/{path.relative_to(TESTS)}": path.read_text(encoding="utf-8") for path in TESTS.rglob("*.py")
    }
    lengths = {name: len(text.splitlines()) for name, text in {**FILES, **tests}.items()}
    assert len(tests) > 100
    assert {name: length for name, length in lengths.items() if length > 400} == {}


def test_few_files_are_under_40_lines() -> None:
    """One thought is in one file; a tenth of them may be small."""
    small = sorted(name for name, text in FILES.items() if len(text.splitlines()) < 40)
    assert len(small) <= len(FILES) / 10, f"{len(small)} of {len(FILES)} files: {', '.join(small)}"


def functions(text: str) -> Iterator[tuple[str, int]]:
    """Each function's name and lines, with its docstring; not what numba compiles."""
    for node in ast.walk(parsed(text)):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if {name for one in node.decorator_list for name in _names(one)}.isdisjoint(COMPILED):
            yield node.name, (node.end_lineno or 0) - node.lineno + 1


def _names(decorator: ast.expr) -> set[str]:
    nodes = list(ast.walk(decorator))
    return {node.id for node in nodes if isinstance(node, ast.Name)} | {
        node.attr for node in nodes if isinstance(node, ast.Attribute)
    }


def test_lines_of_a_function_are_counted_without_kernels() -> None:
    text = 'def a():\n    """One."""\n    return 1\n\n\n@numba.njit(cache=True)\ndef b():\n    pass\n'
    assert list(functions(text)) == [("a", 3)]


def test_no_function_is_over_60_lines() -> None:
    found = [(path, *function) for path, text in FILES.items() for function in functions(text)]
    assert len(found) > 1000
    assert [one for one in found if one[2] > 60] == []


def test_a_public_name_stands_in_one_module() -> None:
    """A reader who searches for a name finds one thing."""
    modules: dict[str, list[str]] = {}
    for path, text in FILES.items():
        for node in parsed(text).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                modules.setdefault(node.name, []).append(path)
    assert len(modules) > 1000
    assert {name: paths for name, paths in modules.items() if len(paths) > 1} == {}


# Where JSON and npz are read or written as such: files of others, what is printed, and owners of other files.
RAW = {
    "core/listing.py": "text in a page",
    "core/storage.py": "the functions themselves",
    "core/untrusted_text.py": "the functions themselves",
    "core/voxels/npz.py": "the functions themselves",
    "core/voxels/pair_file.py": "owner of the pair file",
    "scoring/dataset.py": "samples of WebDataset shards, which others may have written",
    "engine/cluster.py": "the file of a Dask scheduler",
    "core/voxels/recgan_file.py": "files of the 3D-RecGAN authors",
    "cli/": "tables that are printed",
    "stages/ingest/depth_files.py": "depth of recordings, which others wrote",
    "stages/fuse/reconstruction.py": "owner of reconstruction/volume.npz",
    "lab/simulate/writers/": "recordings as other programs write them",
    "lab/simulate/truth.py": "owner of a simulated recording's truth",
    "lab/evaluate/run.py": "settings of one recording, and figures that are written once",
    "lab/synthesize/synthesize.py": "synthesis.json, which has no model yet",
    "release/check/": "a stranger's files, Croissant among them",
    "release/exchange/": "layouts of other programs",
    "release/publish/privacy.py": "any model's content, scrubbed",
    "release/publish/schemas.py": "JSON schemas",
    "release/publish/small_files.py": "Croissant",
    "release/publish/previews.py": "rows as ImageFolder reads them",
    "record/folder.py": "camera.json of a recording, as TUM folders have it",
    "record/guide/process.py": "what the guide's page asks for",
    "report/gallery.py": "text in the page",
    "scoring/adapters/": "files of other methods",
    "scoring/baselines/predict.py": "predictions, as any method's",
    "networks/predict.py": "predictions, as any method's",
    "scoring/camera_shape.py": "predictions, as any method's",
    "core/glb_file.py": "files of other programs",
    "settings/edit.py": "values of YAML",
}
RAW_CALLS = {
    *(
        "json.load",
        "json.loads",
        "json.dump",
        "json.dumps",
        "json.JSONDecoder",
        "strict_json",
        "storage.strict_json",
        "pretty_json",
    ),
    *(
        "np.load",
        "np.savez",
        "np.savez_compressed",
        "load_arrays",
        "arrays_of",
        "npz_bytes",
        "packed_npz_bytes",
    ),
}


def raw_calls(text: str) -> set[str]:
    calls = (node for node in ast.walk(parsed(text)) if isinstance(node, ast.Call))
    return {ast.unparse(call.func) for call in calls} & RAW_CALLS


def test_a_file_is_read_and_written_by_its_owner_only() -> None:
    """All other files have a model in core/artefacts, as docs/architecture.md says."""
    raw = {name for name, text in FILES.items() if raw_calls(text) and not name.startswith("core/artefacts/")}
    assert {name for name in raw if not name.startswith(tuple(RAW))} == set()
    assert [place for place in RAW if not any(name.startswith(place) for name in raw)] == []


MODE_OF_TEXT = re.compile("[rwax][+t]*")


def without_encoding(text: str) -> list[str]:
    """Calls that open a text in the locale's encoding; `open` is told by its mode: archives have one, too."""
    found = []
    for call in ast.walk(parsed(text)):
        if not isinstance(call, ast.Call) or any(word.arg == "encoding" for word in call.keywords):
            continue
        name = call.func.attr if isinstance(call.func, ast.Attribute) else ""
        values = [arg.value for arg in call.args if isinstance(arg, ast.Constant)]
        text_mode = any(isinstance(value, str) and MODE_OF_TEXT.fullmatch(value) for value in values)
        reads = name == "read_text" and not call.args
        if reads or name == "write_text" or (name == "open" and text_mode and len(call.args) == 1):
            found.append(ast.unparse(call))
    return found


def test_text_is_utf_8_whatever_the_locale() -> None:
    """Ruff's PLW1514 finds what it knows to be a path; here any call of these names counts."""
    assert [(name, found) for name, text in FILES.items() if (found := without_encoding(text))] == []


def test_calls_without_an_encoding_are_found() -> None:
    bad = 'a.read_text(errors="replace")\n(b / c).write_text(text)\nb.open("a+")\n'
    good = 'a.read_text(encoding="utf-8")\nread_text(a)\na.open("rb")\nav.open(str(a), "w")\n'
    assert len(without_encoding(bad)) == 3 and without_encoding(good) == []


def test_only_the_console_writes_to_the_terminal() -> None:
    """It alone takes control characters out of what strangers wrote."""
    writers = {"typer.echo", "typer.secho", "print", "sys.stdout.write", "sys.stderr.write", "Console"}
    calls = {
        name: {ast.unparse(node.func) for node in ast.walk(parsed(text)) if isinstance(node, ast.Call)}
        for name, text in FILES.items()
        if name.startswith("cli/")
    }
    # In main.py the version is printed before anything is read.
    assert {name for name, of in calls.items() if of & writers} == {"cli/console.py", "cli/main.py"}


def test_raw_calls_are_found() -> None:
    assert raw_calls("x = np.load(path)\njson.loads(f(text))\nloads(text)\n") == {"np.load", "json.loads"}


# Where files come from strangers: `core/untrusted.py` opens them, and nothing else does.
OF_STRANGERS = (
    "stages/ingest/",
    "doctor/",
    "core/trajectory/text_rows.py",
    "stages/sample_views/views.py",
    "engine/artefact.py",
    "core/artefacts/",
    "core/geometry/",
    "core/images.py",
    "core/voxels/",
    "core/zip_files.py",
    "release/",
    "scoring/adapters/",
    "scoring/api.py",
    "scoring/baselines/",
    "networks/",
    "scoring/camera_shape.py",
    "scoring/truth.py",
)
OPENING = {
    "read_bytes",
    "read_text",
    "imread",
    "VideoCapture",
    "ZipFile",
    "fromfile",
    "loadtxt",
    "memmap",
    "sqlite3.connect",
    "av.open",
}
# Libraries that open files themselves, once `open_plain` or `read_head` had them; and what is written here.
OPENED = {
    (
        "stages/ingest/readers/stray_scanner.py",
        "VideoCapture",
    ): "by its name, after its first bytes were looked at",
    ("stages/ingest/readers/azure_kinect.py", "av.open"): "a file that open_plain opened",
    ("stages/ingest/bags/rosbag2_sqlite.py", "sqlite3.connect"): "read-only, by its name, after open_plain",
    ("core/zip_files.py", "ZipFile"): "of a file that open_plain opened",
    ("core/voxels/npz.py", "ZipFile"): "one that is written",
    ("networks/weights.py", "ZipFile"): "one that is written",
    ("release/publish/archive.py", "ZipFile"): "one that is written",
    ("release/publish/archive.py", "open"): "a release that was just written",
    ("release/publish/card.py", "read_text"): "the package's own file",
    ("release/publish/datasheet.py", "read_text"): "the package's own file",
    ("release/publish/schemas.py", "read_text"): "the package's own file",
}


def openings(text: str) -> set[str]:
    """What opens files to read them, by other means than `core/untrusted.py`."""
    found = set()
    for node in ast.walk(parsed(text)):
        if not isinstance(node, ast.Call):
            continue
        called = ast.unparse(node.func)
        last = called.rpartition(".")[2]
        mode = [
            arg.value for arg in node.args if isinstance(arg, ast.Constant) and isinstance(arg.value, str)
        ]
        if (called in OPENING or last in OPENING) and called != "read_text":  # core/trajectory has one
            found.add(called if called in OPENING else last)
        elif (
            last == "open"
            and called not in ("cls.open", "av.open")
            and (
                called == "open"
                or not (node.args or node.keywords)
                or any(each.startswith("r") for each in mode)
            )
        ):
            found.add("open")
    return found


def test_files_of_strangers_are_opened_in_one_place() -> None:
    files = {name: text for name, text in FILES.items() if name.startswith(OF_STRANGERS)}
    assert len(files) > 50
    found = {(name, what) for name, text in files.items() for what in openings(text)}
    assert found == set(OPENED)


def test_openings_are_found() -> None:
    assert openings('a.read_bytes()\npath.open("rb")\nav.open(f)\n') == {"read_bytes", "open", "av.open"}
    assert openings("open(p)\n") == openings("p.open()\n") == {"open"}
    assert openings('reader.open(path, settings)\nx.open("wb")\nread_text(path)\n') == set()
