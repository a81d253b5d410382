"""Versions of what is kept on disk and used again: one for each algorithm that writes such a thing.

What was written by another version is made again; what was written by the same version is kept, whatever
version the package has. A change of what an algorithm writes raises its version here by one. A change that
only reaches it by its inputs does not: the inputs' own versions say so.
"""

# The stages of a build; then what stands beside them or on them: candidates of boxes, releases, synthetic
# models, tables of scores, and the predictions of baselines.
VERSIONS: dict[str, int] = {
    "ingest": 1,
    "track": 1,
    "fuse": 1,
    "segment": 1,
    "sample-views": 1,
    "pairs": 1,
    "suggest": 1,
    "publish": 2,
    "synthesize": 1,
    "score": 1,
    "baselines": 1,
}
