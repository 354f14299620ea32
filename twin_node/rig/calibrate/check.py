"""Looks for the customary mistakes in a rig: by its own numbers, by a board that it saw, or by an ordinary recording.

Every customary mistake is undone in turn (`mistakes`). By numbers alone, a rig is objected to where no cell looks like
that, and the mistake whose undoing leaves no objection is named; mistakes that leave none either way cannot be told.
A board, or what moves in a recording, tells by how well it fits together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_node.rig.calibrate.barcodes import Barcodes
from twin_node.rig.calibrate.boards import Board
from twin_node.rig.calibrate.bundle import Sighting
from twin_node.rig.calibrate.mistakes import Finding, Mistake, Undone, undone
from twin_node.rig.calibrate.objections import Objections
from twin_node.rig.calibrate.rig_fit import BoardViews, fit
from twin_node.rig.calibrate.scales import ArmInSight, depth_agreement, size_by_depth
from twin_node.rig.rig_checks import IN_SIGHT, aims_off
from twin_node.robot import ArmModel
from twin_node.scene import Float64, FrameSet, Rig

GOOD_SHARE = 0.003
"""Median error on a board of every camera of a usable rig, as a share of the image's width (2 pixels of 640)."""
TELLING_FACTOR = 3.0
"""On a board a mistake is named where undoing it divides the worst camera's median error by this."""
SETS_JUDGED = 12
"""Sets, evenly picked, on which the mistakes are compared: each is off by far more than single sets err."""
CLEARLY_BETTER, BETTER_OF_TWO, SURE_SIGMAS = 0.03, 0.2, 2.0
"""A mistake is named where undoing it explains the motion so much better, and by so many standard errors. A rig of two
cameras has a single pair, in which outlines fit by chance more often."""
SHOWN_IN_IMAGES = set(Mistake) - {Mistake.UNITS, Mistake.BASE, Mistake.SIZE}
"""Mistakes that images can show. Scale and place they cannot; of those the numbers tell units but feet."""
EXPLAINED = 0.35
"""Agreement with the motion below which nothing is explained: real rigs reach 0.7, by chance it is 0."""
DEPTH_AGREES = 0.25
"""Share of depths that agree between cameras of a rig in the right unit; hidden surfaces are the rest."""
OTHER_SIZE, SIZE_GAIN = 0.04, 1.3
"""Distances between cameras are objected to where depth wants them changed by this share, and so many times as many
depths agree then: 1 % of noise wants 2 % and gains 1.06, cameras half a degree and a centimetre off 4 % and 1.26."""
ARM_AGREES = 0.2
"""Agreement with the arm's motion of a rig that is right in the base."""


@dataclass(frozen=True)
class Verdict:
    """What a check came to."""

    findings: tuple[Finding, ...]
    untold: frozenset[Mistake] = frozenset()
    """Mistakes that could be there without showing in what was looked at."""
    agreement: float | None = None
    """How well the rig explains the motion of a recording, 0 to 1; None where that was not looked at."""
    unseen: tuple[str, ...] = ()
    """Cameras that saw nothing together with another one: nothing but their numbers is known of them."""


def check_numbers(rig: Rig) -> Verdict:
    """What the numbers alone tell."""
    objections = Objections()
    complaint = objections.to(rig)
    alternatives = _unobjectionable(rig, objections)
    if complaint is None:
        return Verdict((), frozenset(_kind(mistake) for mistake in alternatives))
    if not alternatives or complaint.mistake is not None:
        return Verdict((complaint,))
    best, *others = _one_of_each_kind(alternatives)
    rivals = [other for other in others if _aims_off(other.rig) < IN_SIGHT]
    cause = ", or ".join(mistake.finding.cause for mistake in (best, *rivals))
    finding = replace(best.finding, cause=f"{cause} ({complaint.cause})", rivals=tuple(map(_kind, rivals)))
    return Verdict((finding,))


def check_against_board(board: Board, rig: Rig, sightings: Sequence[Sighting]) -> Verdict:
    """What sightings of a board by several cameras at once tell.

    The rig is good where it explains them; else every customary mistake is undone in turn, and the one that explains
    them best is named. Where none does, the camera that fits worst is.
    """
    views = BoardViews(board)
    whole, seen = _Misfit.of(board, rig, sightings, views), {sighting.camera for sighting in sightings}
    if whole.share < GOOD_SHARE:
        return Verdict((), unseen=tuple(camera.name for i, camera in enumerate(rig.cameras) if i not in seen))
    few = _some_sets(sightings)
    now, mistakes = _Misfit.of(board, rig, few, views), list(undone(rig))
    then = [_Misfit.of(board, mistake.rig, few, views) for mistake in mistakes]
    best = int(np.argmin([misfit.share for misfit in then]))
    if then[best].share < (now.share / TELLING_FACTOR if np.isfinite(now.share) else GOOD_SHARE):
        found = mistakes[best].finding
        cause = f"{found.cause} (median error {now.worst_px:.1f} px, then {then[best].worst_px:.1f} px)"
        return Verdict((replace(found, cause=cause),))
    if not np.isfinite(whole.share):
        cause = "no board looks as they see it through these lenses: check the coefficients' order, or calibrate anew"
        return Verdict((Finding("", cause),))
    cause = f"its median error is {whole.worst_px:.1f} px and no customary mistake explains it: calibrate anew"
    return Verdict((Finding(whole.worst, cause),))


def check_against_recording(rig: Rig, sets: Sequence[FrameSet], arm: ArmModel | None = None) -> Verdict:
    """What an ordinary recording tells: `sets` of raw images of any size, with the arm's joints where `arm` is given.

    What moves tells wrong poses and lenses; measured depth and the arm tell the unit, which else the numbers do as far
    as they can. Cameras that are in no set are judged by their numbers alone.
    """
    by_numbers = check_numbers(rig)
    if any(finding.mistake in (Mistake.UNITS, Mistake.RESOLUTION) for finding in by_numbers.findings):
        return by_numbers
    shown = {view.camera.name for frames in sets for view in frames.views}
    seeing = replace(rig, cameras=tuple(camera for camera in rig.cameras if camera.name in shown))
    unseen = tuple(camera.name for camera in rig.cameras if camera.name not in shown)
    found = _against_sets(seeing, sets, arm, by_numbers) if seeing.cameras else by_numbers
    return replace(found, unseen=unseen)


def _against_sets(rig: Rig, sets: Sequence[FrameSet], arm: ArmModel | None, by_numbers: Verdict) -> Verdict:
    """What sets tell in which every camera of the rig has images; `by_numbers`: what the numbers do."""
    barcodes = Barcodes(rig, sets)
    if not barcodes.tells or len(rig.cameras) < 2:
        found = _of_other_unit(rig, sets, arm)
        return by_numbers if found is None else Verdict((found,))
    motion = _Motion.of(rig, barcodes)
    finding = motion.finding(not by_numbers.findings) or _of_other_unit(rig, sets, arm)
    if finding is None and motion.now < EXPLAINED:
        cause = (
            f"what moves fits together by {motion.now:.2f} only and no customary mistake explains it: calibrate anew"
        )
        finding = Finding("", cause)
    if finding is not None:
        return Verdict((finding,), agreement=motion.now)
    return Verdict(by_numbers.findings, motion.untold, motion.now)


@dataclass(frozen=True)
class _Motion:
    """How well a rig explains what moves, and how much better it would with each mistake undone."""

    now: float
    mistakes: tuple[Undone, ...]
    """Those whose undoing leaves a rig that cells may have."""
    gains: Float64
    """[M, B] what undoing each adds in each block of the recording."""
    needed: float
    """Gain that counts."""

    @classmethod
    def of(cls, rig: Rig, barcodes: Barcodes) -> _Motion:
        """Of all mistakes that show in images."""
        now = barcodes.agreement(rig)
        mistakes = tuple(_unobjectionable(rig, Objections()))
        gains = np.array([barcodes.agreement(mistake.rig) - now for mistake in mistakes]).reshape(-1, len(now))
        return cls(float(now.mean()), mistakes, gains, CLEARLY_BETTER if len(rig.cameras) > 2 else BETTER_OF_TWO)

    def finding(self, plausible: bool) -> Finding | None:
        """The mistake whose undoing explains the motion best: clearly better than the rig, where that is plausible."""
        if not self.mistakes:
            return None
        best = int(np.argmax(self.gains.mean(1)))
        gain, scatter = float(self.gains[best].mean()), float(self.gains[best].std(ddof=1))
        if plausible and gain < max(self.needed, SURE_SIGMAS * scatter / np.sqrt(self.gains.shape[1])):
            return None
        found = self.mistakes[best].finding
        after = f"what moves then fits together by {self.now + gain:.2f}, not {self.now:.2f}"
        return replace(found, cause=f"{found.cause} ({after})")

    @property
    def untold(self) -> frozenset[Mistake]:
        """Mistakes whose undoing explains the motion about as well."""
        near = self.gains.mean(1) > -self.needed
        return frozenset(_kind(mistake) for mistake, is_near in zip(self.mistakes, near, strict=True) if is_near)


def _of_other_unit(rig: Rig, sets: Sequence[FrameSet], arm: ArmModel | None) -> Finding | None:
    """The unit that measured depth or the arm gives away, where it is not the metre; or the base that the arm does."""
    readings: list[Undone | None] = [None, *(m for m in undone(rig) if _kind(m) in (Mistake.UNITS, Mistake.BASE))]
    depths = [depth_agreement(rig if m is None else m.rig, sets) for m in readings]
    found = _clear(readings, depths, DEPTH_AGREES) or _of_other_size(rig, sets)
    if found is not None or arm is None:
        return found
    sight = ArmInSight(arm, rig, sets)
    return _clear(readings, [sight.agreement(rig if m is None else m.rig) for m in readings], ARM_AGREES)


def _of_other_size(rig: Rig, sets: Sequence[FrameSet]) -> Finding | None:
    """That measured depth wants the cameras nearer to each other, or farther apart."""
    size = size_by_depth(rig, sets)
    if size is None or abs(size.factor - 1) < OTHER_SIZE or size.gain < SIZE_GAIN:
        return None
    percent, too = 100 * abs(1 / size.factor - 1), "large" if size.factor < 1 else "small"
    cause = (
        f"distances between them seem to be {percent:.0f} % too {too} by the depth that they measure, of which "
        f"{size.gain:.1f} times as much would agree: measure a square of the board, and calibrate with its size"
    )
    return Finding("", cause, Mistake.SIZE)


def _clear(readings: Sequence[Undone | None], agreements: Sequence[float | None], good: float) -> Finding | None:
    """The finding of the reading that agrees best, where it is good and twice as good as the rig as it is."""
    scores = [-1.0 if agreement is None else agreement for agreement in agreements]
    best = int(np.argmax(scores))
    reading = readings[best]
    return reading.finding if reading is not None and scores[best] > max(good, 2 * scores[0]) else None


def _unobjectionable(rig: Rig, objections: Objections) -> list[Undone]:
    """Those mistakes that show in images whose undoing leaves a rig that cells may have."""
    return [m for m in undone(rig) if _kind(m) in SHOWN_IN_IMAGES and objections.to(m.rig) is None]


def _one_of_each_kind(mistakes: Sequence[Undone]) -> list[Undone]:
    """Of each kind the one whose undoing makes the cameras look best at one place, the best of all first."""
    best: dict[Mistake, Undone] = {}
    for mistake in sorted(mistakes, key=lambda mistake: _aims_off(mistake.rig)):
        best.setdefault(_kind(mistake), mistake)
    return list(best.values())


def _aims_off(rig: Rig) -> float:
    return aims_off(np.stack([camera.T_base_cam for camera in rig.cameras]))


def _kind(mistake: Undone) -> Mistake:
    assert mistake.finding.mistake is not None
    return mistake.finding.mistake


@dataclass(frozen=True)
class _Misfit:
    """The camera that a rig explains worst."""

    worst: str
    worst_px: float
    """Its median error, pixels; infinite where the board is nowhere as any camera's lens is."""
    share: float
    """The same as a share of its image's width."""

    @classmethod
    def of(cls, board: Board, rig: Rig, sightings: Sequence[Sighting], views: BoardViews) -> _Misfit:
        """Of a rig on sightings."""
        result = fit(board, rig, sightings, views)
        misfits = []
        for number, camera in enumerate(rig.cameras):
            if (residuals := result.of_camera(number)) is not None:
                off_px = float(np.median(np.linalg.norm(residuals, axis=1)))
                misfits.append(cls(camera.name, off_px, off_px / camera.width))
        return max(misfits, key=lambda misfit: misfit.share, default=cls("", np.inf, np.inf))


def _some_sets(sightings: Sequence[Sighting]) -> list[Sighting]:
    boards = sorted({sighting.board for sighting in sightings})
    chosen = {boards[i] for i in np.linspace(0, len(boards) - 1, SETS_JUDGED).round().astype(int)}
    return [sighting for sighting in sightings if sighting.board in chosen]
