"""What the field is worth where something bends, and whether it stays out of what does not."""

from __future__ import annotations

from dataclasses import replace

from twin_node.bench.methods.made_up import MadeUpParameters, make_up
from twin_node.bench.methods.protocol import Budget
from twin_node.bench.methods.table import Report, run


def ablations(parameters: MadeUpParameters, budget: Budget, report: Report) -> dict[str, float]:
    """Figures on scenes of one kind of motion: names as `--json` prints them; those that no image gave are left out.

    `bending_field_gain_db`: moving pixels of held-out cameras, 4DGS on planes less the same without a field.
    `bending_ours_psnr_moving_db`, `bending_ours_deformable`, `rigid_ours_deformable`: of the online model, its most
    DEFORMABLE Gaussians at any time.
    """
    figures: dict[str, float | None] = {}
    bending = make_up(replace(parameters, movers=("bending",)))
    rows = run(bending.recording, bending.truth, budget, ("4dgs_hexplane", "static_3dgs", "ours"), report).rows
    on, off = rows["4dgs_hexplane"].scores.psnr_moving_db, rows["static_3dgs"].scores.psnr_moving_db
    figures["bending_field_on_db"], figures["bending_field_off_db"] = on, off
    figures["bending_field_gain_db"] = None if on is None or off is None else on - off
    figures["bending_ours_psnr_moving_db"] = rows["ours"].scores.psnr_moving_db
    figures["bending_ours_deformable"] = rows["ours"].notes["most_deformable"]
    rigid = make_up(replace(parameters, movers=("rigid",)))
    ours = run(rigid.recording, rigid.truth, budget, ("ours",), report).rows["ours"]
    figures["rigid_ours_psnr_moving_db"] = ours.scores.psnr_moving_db
    figures["rigid_ours_deformable"] = ours.notes["most_deformable"]
    return {name: value for name, value in figures.items() if value is not None}
