"""The paper's own tables: of its real recordings, of its synthetic test sets, and its numbers of parameters.

Source: Yang, Rosa, Markham, Trigoni, Wen: Dense 3D Object Reconstruction from a Single Depth View
(3D-RecGAN++), IEEE TPAMI: all results at 256^3 voxels, each by the number of its table; precision and recall
are those of its Table 11.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass

PUBLISHED_IN = (
    "Yang, Rosa, Markham, Trigoni, Wen: Dense 3D Object Reconstruction from a Single Depth View "
    "(3D-RecGAN++), IEEE TPAMI"
)
LABEL = "published, not comparable"
CATEGORIES = ("bench", "chair", "couch", "table")
# Those that its networks never learnt from (its Sec. 4.5).
UNSEEN = ("car", "faucet", "firearm", "guitar", "monitor", "plane")
Figures = tuple[float, ...]


@dataclass(frozen=True)
class PublishedScore:
    """One method's published means, per category in the order of its table.

    Attributes:
        method: its name in the paper.
        iou: intersection over union.
        ce: cross-entropy, nats a voxel.
        precision: None where the paper has none.
        recall: likewise.
    """

    method: str
    iou: Figures
    ce: Figures
    precision: Figures | None = None
    recall: Figures | None = None


@dataclass(frozen=True)
class PublishedTable:
    """One table of the paper.

    Attributes:
        title: its number, and what its test set is.
        views: how many viewing angles the names of its test folders say; None: real recordings.
        rows: the methods, best first.
        categories: of the test pairs.
    """

    title: str
    views: int | None
    rows: tuple[PublishedScore, ...]
    categories: tuple[str, ...] = CATEGORIES


PUBLISHED = (
    PublishedScore("3D-RecGAN++", (0.177, 0.208, 0.540, 0.156), (0.061, 0.153, 0.314, 0.177)),
    PublishedScore("3D-RecAE", (0.173, 0.203, 0.538, 0.151), (0.065, 0.156, 0.318, 0.180)),
    PublishedScore("3D-EPN", (0.162, 0.190, 0.508, 0.140), (0.090, 0.158, 0.413, 0.187)),
    PublishedScore("Varley et al.", (0.118, 0.152, 0.433, 0.075), (0.073, 0.155, 0.436, 0.191)),
    PublishedScore("Han et al.", (0.166, 0.164, 0.235, 0.146), (0.083, 0.167, 0.352, 0.194)),
)
REAL = PublishedTable("Table 10 (real recordings)", None, PUBLISHED)
SYNTHETIC = (
    PublishedTable(
        "Table 1 (test_125, a network for each category)",
        125,
        (
            PublishedScore("3D-RecGAN++", (0.580, 0.647, 0.753, 0.679), (0.034, 0.060, 0.066, 0.040)),
            PublishedScore("3D-RecAE", (0.577, 0.641, 0.749, 0.675), (0.036, 0.063, 0.067, 0.043)),
            PublishedScore("3D-EPN", (0.423, 0.488, 0.631, 0.508), (0.087, 0.105, 0.144, 0.101)),
            PublishedScore("Varley et al.", (0.227, 0.317, 0.544, 0.233), (0.111, 0.157, 0.195, 0.191)),
            PublishedScore("Han et al.", (0.441, 0.426, 0.446, 0.499), (0.045, 0.081, 0.165, 0.058)),
        ),
    ),
    PublishedTable(
        "Table 2 (test_216, a network for each category)",
        216,
        (
            PublishedScore("3D-RecGAN++", (0.531, 0.594, 0.646, 0.618), (0.041, 0.074, 0.111, 0.053)),
            PublishedScore("3D-RecAE", (0.524, 0.588, 0.639, 0.610), (0.045, 0.079, 0.117, 0.058)),
            PublishedScore("3D-EPN", (0.408, 0.446, 0.572, 0.482), (0.086, 0.112, 0.163, 0.103)),
            PublishedScore("Varley et al.", (0.185, 0.278, 0.475, 0.187), (0.108, 0.171, 0.210, 0.186)),
            PublishedScore("Han et al.", (0.439, 0.426, 0.455, 0.482), (0.047, 0.090, 0.163, 0.060)),
        ),
    ),
    PublishedTable(
        "Table 3 (test_125, one network for all categories)",
        125,
        (
            PublishedScore(
                *("3D-RecGAN++", (0.581, 0.640, 0.745, 0.667), (0.030, 0.051, 0.063, 0.039)),
                *((0.680, 0.747, 0.804, 0.754), (0.804, 0.820, 0.910, 0.853)),
            ),
            PublishedScore(
                *("3D-RecAE", (0.576, 0.632, 0.740, 0.661), (0.037, 0.060, 0.069, 0.044)),
                *((0.668, 0.740, 0.800, 0.750), (0.808, 0.818, 0.907, 0.845)),
            ),
            PublishedScore("3D-EPN", (0.428, 0.484, 0.634, 0.506), (0.087, 0.107, 0.138, 0.102)),
            PublishedScore("Varley et al.", (0.234, 0.317, 0.543, 0.236), (0.103, 0.132, 0.197, 0.170)),
            PublishedScore("Han et al.", (0.425, 0.454, 0.440, 0.470), (0.045, 0.087, 0.172, 0.065)),
        ),
    ),
    PublishedTable(
        "Table 4 (test_216, one network for all categories)",
        216,
        (
            PublishedScore("3D-RecGAN++", (0.540, 0.594, 0.643, 0.621), (0.038, 0.061, 0.091, 0.048)),
            PublishedScore("3D-RecAE", (0.530, 0.587, 0.640, 0.610), (0.043, 0.068, 0.096, 0.055)),
            PublishedScore("3D-EPN", (0.415, 0.452, 0.531, 0.477), (0.091, 0.115, 0.147, 0.111)),
            PublishedScore("Varley et al.", (0.201, 0.283, 0.480, 0.199), (0.105, 0.143, 0.207, 0.174)),
            PublishedScore("Han et al.", (0.429, 0.444, 0.447, 0.474), (0.045, 0.089, 0.172, 0.063)),
        ),
    ),
    PublishedTable(
        "Tables 5 and 6 (test_125, categories never learnt from)",
        125,
        (
            PublishedScore(
                *("3D-RecGAN++", (0.555, 0.536, 0.426, 0.442, 0.562, 0.394)),
                (0.102, 0.053, 0.016, 0.014, 0.067, 0.031),
            ),
            PublishedScore(
                *("3D-RecAE", (0.557, 0.530, 0.422, 0.440, 0.556, 0.390)),
                (0.110, 0.057, 0.018, 0.016, 0.072, 0.036),
            ),
            PublishedScore(
                *("3D-EPN", (0.450, 0.442, 0.339, 0.351, 0.444, 0.314)),
                (0.170, 0.088, 0.036, 0.036, 0.123, 0.066),
            ),
            PublishedScore(
                *("Varley et al.", (0.484, 0.260, 0.280, 0.255, 0.341, 0.295)),
                (0.173, 0.122, 0.029, 0.030, 0.130, 0.042),
            ),
            PublishedScore(
                *("Han et al.", (0.360, 0.402, 0.333, 0.353, 0.450, 0.306)),
                (0.167, 0.077, 0.018, 0.015, 0.088, 0.031),
            ),
        ),
        UNSEEN,
    ),
    PublishedTable(
        "Tables 7 and 8 (test_216, categories never learnt from)",
        216,
        (
            PublishedScore(
                *("3D-RecGAN++", (0.553, 0.529, 0.416, 0.449, 0.555, 0.390)),
                (0.100, 0.055, 0.014, 0.015, 0.074, 0.031),
            ),
            PublishedScore(
                *("3D-RecAE", (0.550, 0.521, 0.411, 0.441, 0.550, 0.382)),
                (0.101, 0.059, 0.017, 0.017, 0.079, 0.036),
            ),
            PublishedScore(
                *("3D-EPN", (0.446, 0.439, 0.324, 0.359, 0.448, 0.309)),
                (0.160, 0.087, 0.033, 0.036, 0.127, 0.065),
            ),
            PublishedScore(
                *("Varley et al.", (0.489, 0.260, 0.274, 0.255, 0.334, 0.283)),
                (0.171, 0.123, 0.028, 0.030, 0.136, 0.043),
            ),
            PublishedScore(
                *("Han et al.", (0.349, 0.402, 0.321, 0.363, 0.455, 0.299)),
                (0.171, 0.076, 0.018, 0.016, 0.088, 0.031),
            ),
        ),
        UNSEEN,
    ),
    PublishedTable(
        "Table 9 (test_125, learnt from one category)",
        125,
        (
            PublishedScore(
                "3D-RecGAN++ of bench", (0.580, 0.510, 0.507, 0.599), (0.034, 0.110, 0.164, 0.062)
            ),
            PublishedScore(
                "3D-RecGAN++ of chair", (0.508, 0.647, 0.469, 0.564), (0.048, 0.060, 0.184, 0.069)
            ),
            PublishedScore(
                "3D-RecGAN++ of couch", (0.429, 0.504, 0.753, 0.437), (0.070, 0.105, 0.066, 0.126)
            ),
            PublishedScore(
                "3D-RecGAN++ of table", (0.510, 0.509, 0.402, 0.679), (0.049, 0.111, 0.260, 0.040)
            ),
        ),
    ),
)
# Table 12, millions.
PARAMETERS = {"3D-EPN": 52.4, "Varley et al.": 430.3, "Han et al.": 7.5, "3D-RecGAN++": 167.1}
PARAMETERS_LINE = "The paper's numbers of parameters, millions (Table 12): " + ", ".join(
    f"{name} {count}" for name, count in PARAMETERS.items()
)
_IMPORTED = re.compile(r".+-(125|216)")


def published_beside(
    recordings: Iterable[str], categories: Iterable[str] = CATEGORIES
) -> tuple[PublishedTable, ...]:
    """The paper's tables to show beside scores: synthetic ones for imported data, else the real one.

    Args:
        recordings: of the test split. Those that `import` makes of the authors' files end in the number of
            views in the names of their folders.
        categories: of the test split; a synthetic table without any of them is left out.
    """
    views = {int(match[1]) if (match := _IMPORTED.fullmatch(name)) else None for name in recordings}
    if len(views) != 1 or None in views:
        return (REAL,)
    present = set(categories)
    return tuple(table for table in SYNTHETIC if table.views in views and present & set(table.categories))
