"""Write one recording's files into a release: pairs, views, object; only inputs if truth is held back."""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from statistics import fmean

from kinectbench.core import IMAGE_BYTES, PairError, ReleaseError, read_plain, write_below
from kinectbench.core.artefacts.benchmark import RecordingInfo
from kinectbench.core.artefacts.manifest import Manifest, Sources
from kinectbench.core.artefacts.object import FloorFile, QualityFile
from kinectbench.core.artefacts.provenance import (
    LineageRecording,
    LineageStage,
    LineageView,
    Removed,
    files_hash,
)
from kinectbench.core.artefacts.sequence import CameraFile
from kinectbench.core.artefacts.stored import Stored
from kinectbench.core.artefacts.targets import Target
from kinectbench.core.artefacts.views import PairsFile, ViewRow, ViewsFile
from kinectbench.core.geometry import Camera
from kinectbench.core.voxels.pair_file import (
    SHARE_DECIMALS,
    Pair,
    checked_pair,
    pair_bytes,
    pair_content,
    pair_values,
)
from kinectbench.engine.stages import STAGES
from kinectbench.release.contents import OBJECT_FILES, VIEW_IMAGES
from kinectbench.release.publish.held_back import (
    SAID_OF_TRUTH,
    isolated_input,
    isolated_view,
    only_view,
    own_floor,
    own_views,
    without_truth,
    write_isolated_images,
)
from kinectbench.release.publish.privacy import scrubbed_file, scrubbed_jpeg
from kinectbench.release.publish.reconstruction_attack import PosedView, attack_ious, read_posed_view
from kinectbench.release.triage.rules import current_reference
from kinectbench.settings.models import BenchmarkSettings, RecordingSettings


@dataclass(frozen=True)
class Built:
    """A built recording that is to be published.

    Attributes:
        settings: the benchmark's settings.
        recording: the recording's settings.
        folder: `build/<recording>/`.
        hidden: whether the recording's truth is held back.
        most_named: largest number of files that lineage.json lists one by one; of more, it has one hash.
        only: with `--isolate`, the name in the build of the only published view; None: all are published.
    """

    settings: BenchmarkSettings
    recording: RecordingSettings
    folder: Path
    hidden: bool
    most_named: int
    only: str | None = None

    @property
    def isolated(self) -> bool:
        """Whether only one view of the recording is published, without its truth."""
        return self.hidden and self.only is not None

    def built_name(self, view: str) -> str:
        """Return the name that a published view has in the build."""
        return view if self.only is None else self.only

    @cached_property
    def pairs(self) -> PairsFile:
        """Content of pairs.json, reduced to the view `only` if it is set."""
        pairs = PairsFile.read(self.folder / "pairs")
        if self.only is None:
            return pairs
        return PairsFile(pairs=only_view(pairs.pairs, self.only), refused=())

    @cached_property
    def views(self) -> ViewsFile:
        """Content of views.json, reduced to the view `only` if it is set."""
        views = ViewsFile.read(self.folder / "views")
        if self.only is None:
            return views
        return views.model_copy(update={"views": only_view(views.views, self.only), "refused": ()})

    @cached_property
    def camera(self) -> Camera:
        """The depth camera of all views."""
        return CameraFile.read(self.folder / "sequence").camera

    @cached_property
    def posed_views(self) -> dict[str, PosedView]:
        """The views with a pair, {published name: view}; an isolated view is restricted to the object."""
        published = {row.view for row in self.pairs.pairs}
        return {row.view: self._posed(row) for row in self.views.views if row.view in published}

    def _posed(self, row: ViewRow) -> PosedView:
        if row.T_world_camera is None:
            raise ReleaseError(
                f"view {row.view}: views.json does not say its pose; build it again", what="not-built"
            )
        name = self.built_name(row.view)
        view = read_posed_view(self.folder / "views", name, self.camera, row.T_world_camera)
        return isolated_view(view) if self.isolated else view

    @cached_property
    def quality(self) -> QualityFile:
        """The quality of the recording's object."""
        return QualityFile.read(self.folder / "object")


@dataclass(frozen=True)
class Published:
    """The published part of a recording.

    Attributes:
        targets: the recording's pairs, at least one.
        info: the recording's entry in benchmark.json.
        lineage: the recording's entry in lineage.json.
        has_color: whether its views have colour, published or not.
    """

    targets: tuple[Target, ...]
    info: RecordingInfo
    lineage: LineageRecording
    has_color: bool


def publish_recording(built: Built, folder: Path, removals: list[Removed]) -> Published | None:
    """Write one recording's files into a release; return its published part, or None if it has no pair.

    Removed private facts are added to `removals`.

    Raises:
        ReleaseError: a pair or another file to copy is missing, a pair is damaged, or it has another framing
            or rule than the benchmark.
        StorageError: a JSON file or an image of the build is missing or damaged.
    """
    names = sorted(row.view for row in built.pairs.pairs)
    if not names:
        return None
    pairs = {view: _publish_pair(built, view, folder) for view in names}
    targets = tuple(target for target, _ in pairs.values())
    if not built.isolated:
        _publish_object(built, folder, removals)
    has_color = _publish_views(built, targets, folder, removals)
    info = _info(built, [share for _, share in pairs.values()], removals)
    return Published(targets, info, _lineage(built, names), has_color)


def _read_pair(built: Built, view: str) -> tuple[bytes, Pair]:
    """Read a built pair: return its file's bytes and the pair; check its framing and partial rule."""
    path = built.folder / "pairs" / f"{built.built_name(view)}.npz"
    try:
        content = pair_content(path)
        pair = checked_pair(Pair, pair_values(content, str(path)), str(path))
    except PairError as error:
        raise ReleaseError(str(error)) from error
    for key in ("framing", "partial_rule"):
        stored, wanted = getattr(pair, key), getattr(built.settings.pairs, key)
        if stored != wanted:
            raise ReleaseError(
                f"{path}: {key} is '{stored}', the settings say '{wanted}'; run pairs again", what="not-built"
            )
    return content, pair


def _publish_pair(built: Built, view: str, folder: Path) -> tuple[Target, float]:
    """Write a pair into a release as built, or only its input if its truth is held back.

    Return the pair's target, and the share of the true surface that its view sees.
    """
    recording = built.recording
    content, pair = _read_pair(built, view)
    if built.isolated:
        content = pair_bytes(isolated_input(pair, built.posed_views[view]))
    elif built.hidden:
        floor = FloorFile.read(built.folder / "object")
        content = pair_bytes(without_truth(pair, floor.T_floor_world))
    file = f"pairs/{recording.id}/{view}.npz"
    write_below(folder / file, content)
    target = Target(
        recording=recording.id,
        object=recording.object_name,
        view=view,
        category=recording.category,
        split=recording.split,
        file=file,
        sha256=sha256(content).hexdigest(),
        unknown_share=None if built.hidden else pair.stated_unknown_share,
        truth="" if built.hidden or built.quality.truth is None else built.quality.truth.kind,
    )
    return target, pair.visible_share


def _publish_object(built: Built, folder: Path, removals: list[Removed]) -> None:
    """Write an object's mesh, volume, floor and quality; if its truth is held back, write only the floor."""
    source, name = built.folder / "object", f"objects/{built.recording.id}"
    (folder / name).mkdir(parents=True)
    for file in OBJECT_FILES if not built.hidden else ():
        _copy_built(source / file, folder / name / file)
    floor = FloorFile.read(source)
    _write(own_floor(floor) if built.hidden else floor, folder, name, removals)
    if not built.hidden:
        _write(built.quality, folder, name, removals)


def _publish_views(built: Built, targets: Sequence[Target], folder: Path, removals: list[Removed]) -> bool:
    """Write depth and mask of every view with a pair, colour if requested, and views.json.

    Images are copied from the build; colour loses its metadata. Images of an isolated view are made from its
    restricted depth and mask. Return whether the build has colour images of these views.
    """
    source, name = built.folder / "views", f"views/{built.recording.id}"
    (folder / name).mkdir(parents=True)
    has_color = False
    for view in (target.view for target in targets):
        name_in_build = built.built_name(view)
        color = source / f"{name_in_build}.color.jpg"
        has_color |= color.is_file()
        shown = color if built.settings.publish.color and color.is_file() else None
        if built.isolated:
            registered = shown if built.views.color_registered else None
            write_isolated_images(built.posed_views[view], registered, folder / name)
            continue
        for suffix in VIEW_IMAGES:
            _copy_built(source / f"{name_in_build}{suffix}", folder / name / f"{view}{suffix}")
        if shown is not None:
            image = f"{name}/{view}.color.jpg"
            data = scrubbed_jpeg(read_plain(shown, IMAGE_BYTES), image, removals)
            (folder / image).write_bytes(data)
    views = _with_pairs(built.views, built.camera, targets)
    _write(own_views(views) if built.hidden else views, folder, name, removals)
    return has_color


def _with_pairs(views: ViewsFile, camera: Camera, targets: Sequence[Target]) -> ViewsFile:
    """Return views.json with more keys in each row: K, image size, whether it has a pair, unknown share."""
    more: dict[str, object] = {"K": camera.K, "width": camera.width, "height": camera.height}
    shares = {target.view: target.unknown_share for target in targets}
    rows = []
    for row in views.views:
        of_pair: dict[str, object] = {"pair": row.view in shares}
        if row.view in shares:
            of_pair["unknown_share"] = shares[row.view]
        rows.append(row.model_copy(update=more | of_pair))
    return views.model_copy(update={"views": tuple(rows)})


def _info(built: Built, visible_shares: Sequence[float], removals: list[Removed]) -> RecordingInfo:
    """Return a recording's entry in benchmark.json; `visible_shares` has a value for each of its pairs."""
    recording = built.recording
    quality = QualityFile() if built.hidden else _without_method(built.quality)
    refused = (*built.views.refused, *built.pairs.refused)
    info = RecordingInfo(
        object=recording.object_name,
        category=recording.category,
        split=recording.split,
        pairs=len(visible_shares),
        refused=len(refused),
        quality=scrubbed_file(quality, "benchmark.json", removals),
        license=built.settings.license_of(recording),
        source=built.settings.source_of(recording),
    )
    if not built.hidden:
        more: dict[str, object] = {"visible_share": round(fmean(visible_shares), SHARE_DECIMALS)}
        if (reference := current_reference(built.folder)) is not None:
            more["reference"] = reference.info
        return info.model_copy(update=more)
    iou, single_iou = attack_ious(built.posed_views, lambda view: _read_pair(built, view)[1])
    return info.model_copy(update={"rebuilt_iou": iou, "rebuilt_single_iou": single_iou})


def _without_method(quality: QualityFile) -> QualityFile:
    """Return a quality without its key `method`, which is long and the same for all recordings."""
    kept = quality.model_fields_set - {"method"}
    return QualityFile.model_construct(kept, **{key: getattr(quality, key) for key in kept})


def _write(stored: Stored, folder: Path, name: str, removals: list[Removed]) -> None:
    """Write a JSON file into the folder `name` of a release, without private facts."""
    scrubbed_file(stored, f"{name}/{stored.FILE}", removals).write(folder / name)


def _lineage(built: Built, names: Sequence[str]) -> LineageRecording:
    """Return a recording's entry in lineage.json: its files, stages and the frames of its views.

    If its truth is held back, the frames and the user's statements about the object are left out. An isolated
    recording has only source and licence.
    """
    if built.isolated:
        return LineageRecording(
            source=built.settings.source_of(built.recording),
            license=built.settings.license_of(built.recording),
            files={},
            stages={},
        )
    # A recording that is a single file has no names below itself.
    files = {
        name or Path(built.recording.path).name: digest
        for name, digest in sorted(Sources.read(built.folder).sha256.items())
    }
    named = len(files) <= built.most_named
    content = LineageRecording(
        source=built.settings.source_of(built.recording),
        license=built.settings.license_of(built.recording),
        files=files if named else {},
        stages={stage.name: _stage(built.folder / stage.folder, built.hidden) for stage in STAGES},
    )
    if not named:
        content = content.model_copy(update={"files_sha256": files_hash(files)})
    if built.hidden:
        return content
    rows = {row.view: row for row in built.views.views}
    return content.model_copy(
        update={"views": tuple(_lineage_view(rows[name]) for name in names if name in rows)}
    )


def _lineage_view(row: ViewRow) -> LineageView:
    if row.frame is None or row.stamp_ns is None:
        raise ReleaseError(
            f"view {row.view}: views.json does not say of which frame it is; build it again", what="not-built"
        )
    return LineageView(view=row.view, frame=row.frame, stamp_ns=row.stamp_ns)


def _stage(folder: Path, hidden: bool) -> LineageStage:
    """Return a stage's entry in lineage.json; if `hidden`, without the user's statements about the object."""
    manifest = Manifest.read(folder)
    return LineageStage(
        package_version=manifest.package_version,
        stage_version=manifest.stage_version,
        settings={
            key: value for key, value in manifest.settings.items() if not (hidden and key in SAID_OF_TRUTH)
        },
        fingerprint=manifest.fingerprint,
    )


def _copy_built(source: Path, target: Path) -> None:
    if not source.is_file():
        raise ReleaseError(f"{source}: missing; run the build again", what="not-built")
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, target)
