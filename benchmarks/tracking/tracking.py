"""The camera tracker against its bars: accuracy, share tracked, time and memory, beside Open3D's trackers.

Simulated recordings have an exact trajectory, of which the tracker is told nothing; DATA is a folder of real
ones (`tum_fr3_cabinet`, `7scenes_redkitchen_000-149`). ATE and RPE are root mean squares after alignment
without scale, over the frames with a pose. Each row runs in a process of its own. With --cache, recordings
and finished rows are kept; a row is measured again when the code it stands on has changed. All of it takes
hours; --only and --objects choose.
"""

import argparse
import json
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from itertools import groupby
from pathlib import Path

from builds import build_root
from figures import arguments, missed
from tracking_bars import bar_figures, markdown
from tracking_cases import GROUPS, REAL, RIVALS, Case, all_cases, chosen
from tracking_measure import Task, measure_apart
from tracking_recordings import OBJECTS, ingested
from tracking_rows import KeptRows, Row, code_of

from kinectbench.core.errors import KinectBenchError


def measured(cases: Sequence[Case], kept: KeptRows, *, rivals: bool) -> Iterator[Row]:
    """Every row of the cases, ours first; what is ingested of a recording serves all of its rows."""
    for _, of_source in groupby(cases, key=lambda case: case.source):
        wanted = [(case, m) for case in of_source for m in case.methods if rivals or m not in RIVALS]
        with ExitStack() as stack:
            folder: Path | None = None
            for case, method in wanted:
                outcome = kept.kept(case, method)
                if outcome is None:
                    folder = folder or stack.enter_context(ingested(case.open()))
                    task = Task(method, folder, case.stride, case.first, case.warm_up)
                    made_by = code_of(method)
                    outcome = measure_apart(task)
                    kept.keep(case, method, made_by, outcome)
                yield Row(case, method, outcome)


def parsed() -> argparse.Namespace:
    """The options."""
    parser = arguments(__doc__)
    given = os.environ.get("KINECTBENCH_DATA")
    default = Path(given) if given else None
    parser.add_argument("data", type=Path, nargs="?", default=default, help="default: $KINECTBENCH_DATA")
    parser.add_argument("--cache", type=Path, metavar="DIR", help="keep recordings and finished rows there")
    parser.add_argument(
        "--only", nargs="+", default=[], metavar="NAME", help=f"recordings, or any of {', '.join(GROUPS)}"
    )
    parser.add_argument("--objects", type=int, default=len(OBJECTS), help="simulated objects, of 12")
    parser.add_argument("--no-competitors", action="store_true", help="only ours")
    parser.add_argument("--fresh", action="store_true", help="measure finished rows again")
    return parser.parse_args()


def main() -> None:
    options = parsed()
    with build_root(options.cache) as cache:
        cases = chosen(all_cases(cache, options.data, options.objects), options.only)
        if options.data is None:
            print(f"without DATA there is no {', '.join(REAL)}")
        if not cases:
            sys.exit(f"error: --only {' '.join(options.only)}: there is no such recording or group")
        rows, kept = [], KeptRows(cache / "results", options.fresh)
        try:
            for row in measured(cases, kept, rivals=not options.no_competitors):
                print(row.line(), flush=True)
                rows.append(row)
        except KinectBenchError as error:
            sys.exit(f"error: {error}")
    figures = bar_figures(rows)
    print("", markdown(figures), sep="\n")
    if options.json:
        content = {"met": not missed(figures), "figures": [asdict(figure) for figure in figures]}
        content["rows"] = [row.figures() for row in rows]
        options.json.write_text(json.dumps(content, indent=1) + "\n")
    if missed(figures):
        sys.exit(1)


if __name__ == "__main__":
    main()
