"""The tables of the 3D-RecGAN++ paper, on its real recordings and synthetic test sets; its networks' sizes.

Source: Yang, Rosa, Markham, Trigoni, Wen: Dense 3D Object Reconstruction from a Single Depth View
(3D-RecGAN++), IEEE TPAMI. All results are at 256^3 voxels. Tables are numbered as in the paper; precision and
recall are from its Table 11.
"""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

PUBLISHED_IN = (
    "Yang, Rosa, Markham, Trigoni, Wen: Dense 3D Object Reconstruction from a Single Depth View "
    "(3D-RecGAN++), IEEE TPAMI"
)
LABEL = "published, not comparable"
CATEGORIES = ("bench", "chair", "couch", "table")
# Categories that the paper's networks were not trained on (its Sec. 4.5).
UNSEEN = ("car", "faucet", "firearm", "guitar", "monitor", "plane")
Figures = tuple[float, ...]


@dataclass(frozen=True)
class PublishedScore:
    """The published means of one method, one value per category, in the order of its table's categories.

    Attributes:
        method: its name in the paper.
        iou: intersection over union.
        ce: cross-entropy, nats per voxel.
        precision: None where the paper has none.
        recall: None where the paper has none.
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
        title: the table's number and test set.
        views: number of viewing angles, as in the names of the test folders; None for real recordings.
        rows: the methods, best first.
        categories: the categories of the test pairs.
    """

    title: str
    views: int | None
    rows: tuple[PublishedScore, ...]
    categories: tuple[str, ...] = CATEGORIES


# After the title of each table, a line for each method: IoU in each category, then cross-entropy, then
# precision and recall if the paper has them.
_TABLES = """\
Table 10 (real recordings)
    3D-RecGAN++           .177 .208 .540 .156  .061 .153 .314 .177
    3D-RecAE              .173 .203 .538 .151  .065 .156 .318 .180
    3D-EPN                .162 .190 .508 .140  .090 .158 .413 .187
    Varley et al.         .118 .152 .433 .075  .073 .155 .436 .191
    Han et al.            .166 .164 .235 .146  .083 .167 .352 .194
Table 1 (test_125, a network for each category)
    3D-RecGAN++           .580 .647 .753 .679  .034 .060 .066 .040
    3D-RecAE              .577 .641 .749 .675  .036 .063 .067 .043
    3D-EPN                .423 .488 .631 .508  .087 .105 .144 .101
    Varley et al.         .227 .317 .544 .233  .111 .157 .195 .191
    Han et al.            .441 .426 .446 .499  .045 .081 .165 .058
Table 2 (test_216, a network for each category)
    3D-RecGAN++           .531 .594 .646 .618  .041 .074 .111 .053
    3D-RecAE              .524 .588 .639 .610  .045 .079 .117 .058
    3D-EPN                .408 .446 .572 .482  .086 .112 .163 .103
    Varley et al.         .185 .278 .475 .187  .108 .171 .210 .186
    Han et al.            .439 .426 .455 .482  .047 .090 .163 .060
Table 3 (test_125, one network for all categories)
    3D-RecGAN++           .581 .640 .745 .667  .030 .051 .063 .039  .680 .747 .804 .754  .804 .820 .910 .853
    3D-RecAE              .576 .632 .740 .661  .037 .060 .069 .044  .668 .740 .800 .750  .808 .818 .907 .845
    3D-EPN                .428 .484 .634 .506  .087 .107 .138 .102
    Varley et al.         .234 .317 .543 .236  .103 .132 .197 .170
    Han et al.            .425 .454 .440 .470  .045 .087 .172 .065
Table 4 (test_216, one network for all categories)
    3D-RecGAN++           .540 .594 .643 .621  .038 .061 .091 .048
    3D-RecAE              .530 .587 .640 .610  .043 .068 .096 .055
    3D-EPN                .415 .452 .531 .477  .091 .115 .147 .111
    Varley et al.         .201 .283 .480 .199  .105 .143 .207 .174
    Han et al.            .429 .444 .447 .474  .045 .089 .172 .063
Tables 5 and 6 (test_125, categories never learnt from)
    3D-RecGAN++           .555 .536 .426 .442 .562 .394  .102 .053 .016 .014 .067 .031
    3D-RecAE              .557 .530 .422 .440 .556 .390  .110 .057 .018 .016 .072 .036
    3D-EPN                .450 .442 .339 .351 .444 .314  .170 .088 .036 .036 .123 .066
    Varley et al.         .484 .260 .280 .255 .341 .295  .173 .122 .029 .030 .130 .042
    Han et al.            .360 .402 .333 .353 .450 .306  .167 .077 .018 .015 .088 .031
Tables 7 and 8 (test_216, categories never learnt from)
    3D-RecGAN++           .553 .529 .416 .449 .555 .390  .100 .055 .014 .015 .074 .031
    3D-RecAE              .550 .521 .411 .441 .550 .382  .101 .059 .017 .017 .079 .036
    3D-EPN                .446 .439 .324 .359 .448 .309  .160 .087 .033 .036 .127 .065
    Varley et al.         .489 .260 .274 .255 .334 .283  .171 .123 .028 .030 .136 .043
    Han et al.            .349 .402 .321 .363 .455 .299  .171 .076 .018 .016 .088 .031
Table 9 (test_125, learnt from one category)
    3D-RecGAN++ of bench  .580 .510 .507 .599  .034 .110 .164 .062
    3D-RecGAN++ of chair  .508 .647 .469 .564  .048 .060 .184 .069
    3D-RecGAN++ of couch  .429 .504 .753 .437  .070 .105 .066 .126
    3D-RecGAN++ of table  .510 .509 .402 .679  .049 .111 .260 .040
"""


def _tables() -> Iterator[PublishedTable]:
    for block in re.split(r"\n(?=T)", _TABLES.strip()):
        title, *lines = block.split("\n")
        categories = UNSEEN if "never learnt from" in title else CATEGORIES
        rows = []
        for line in lines:
            name, *columns = re.split(" {2,}", line.strip())
            figures = [tuple(float(figure) for figure in column.split()) for column in columns]
            assert {len(column) for column in figures} == {len(categories)}, line
            rows.append(PublishedScore(name, *figures))
        views = re.search("test_([0-9]+)", title)
        yield PublishedTable(title, int(views[1]) if views else None, tuple(rows), categories)


REAL, *SYNTHETIC = _tables()
# Table 12, millions of parameters.
PARAMETERS = {"3D-EPN": 52.4, "Varley et al.": 430.3, "Han et al.": 7.5, "3D-RecGAN++": 167.1}
PARAMETERS_LINE = "The paper's numbers of parameters, millions (Table 12): " + ", ".join(
    f"{name} {count}" for name, count in PARAMETERS.items()
)
_IMPORTED = re.compile(r".+-(125|216)")


def published_beside(
    recordings: Iterable[str], categories: Iterable[str] = CATEGORIES
) -> tuple[PublishedTable, ...]:
    """Return the paper's tables to show beside scores: synthetic tables for imported data, else the real one.

    Args:
        recordings: names of the test split's recordings. The names that `import` gives to the authors' files
            end in the number of views.
        categories: categories of the test split; a synthetic table without any of them is left out.
    """
    views = {int(match[1]) if (match := _IMPORTED.fullmatch(name)) else None for name in recordings}
    if len(views) != 1 or None in views:
        return (REAL,)
    present = set(categories)
    return tuple(table for table in SYNTHETIC if table.views in views and present & set(table.categories))
