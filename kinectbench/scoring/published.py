"""What the paper published for real recordings. Other data, other truth: not comparable."""

from dataclasses import dataclass

SOURCE = (
    "Yang, Rosa, Markham, Trigoni, Wen: Dense 3D Object Reconstruction from a Single Depth View "
    "(3D-RecGAN++), IEEE TPAMI, real-world data set"
)
LABEL = "published, not comparable"
CATEGORIES = ("bench", "chair", "couch", "table")


@dataclass(frozen=True)
class PublishedScore:
    """One method's published means, per category in the order of `CATEGORIES`.

    Attributes:
        method: its name in the paper.
        iou: intersection over union.
        ce: cross-entropy, nats a voxel.
    """

    method: str
    iou: tuple[float, float, float, float]
    ce: tuple[float, float, float, float]


PUBLISHED = (
    PublishedScore("3D-RecGAN++", (0.177, 0.208, 0.540, 0.156), (0.061, 0.153, 0.314, 0.177)),
    PublishedScore("3D-RecAE", (0.173, 0.203, 0.538, 0.151), (0.065, 0.156, 0.318, 0.180)),
    PublishedScore("3D-EPN", (0.162, 0.190, 0.508, 0.140), (0.090, 0.158, 0.413, 0.187)),
    PublishedScore("Varley et al.", (0.118, 0.152, 0.433, 0.075), (0.073, 0.155, 0.436, 0.191)),
    PublishedScore("Han et al.", (0.166, 0.164, 0.235, 0.146), (0.083, 0.167, 0.352, 0.194)),
)
