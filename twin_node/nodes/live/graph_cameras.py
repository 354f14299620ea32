"""The cameras of a running graph, from what it says itself: image topics, CameraInfo and static transforms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

from twin_node.messages import Message, MessageError
from twin_node.messages.convert import TransformTree, of_pair, rig_camera
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.topics import TF_STATIC, CameraTopics, GraphError, find_cameras
from twin_node.nodes.viewer import LiveCameras
from twin_node.rig import FrameAssembler, RigError
from twin_node.runtime.rmw_zenoh import EntityKind
from twin_node.scene import Rig, RigCamera


class GraphCameras:
    """Called again and again, gives the calibrated cameras whenever there are others than at the call before."""

    def __init__(self, setup: Setup, width: int, rig: Rig | None) -> None:
        """`width`: of the views, px; `rig`: calibration in place of the graph's own."""
        self._bus = setup.bus
        self._endpoints = setup.endpoints
        self._say = setup.say
        self._width = width
        self._rig = rig
        self._tree = TransformTree()
        self._infos: dict[str, Message] = {}
        self._asked: set[str] = set()
        self._known: tuple[tuple[str, ...], tuple[bytes, ...]] = ((), ())
        self._is_listening = False

    def __call__(self) -> LiveCameras | None:
        """None where nothing has changed; to be called from the node's configuration on."""
        if not self._is_listening:
            self._is_listening = True
            self._bus.subscribe(TF_STATIC, self._tree.add)
        cameras = self._published()
        for camera in cameras:
            if camera.info not in self._asked and self._rig is None:
                self._asked.add(camera.info)
                self._bus.declare(camera.info, camera.kinds[camera.info])
                self._bus.subscribe(camera.info, partial(self._infos.__setitem__, camera.info))
        calibrated = self._calibrated(cameras)
        names = {camera.name for camera in calibrated}
        topics = tuple(camera for camera in cameras if camera.name in names)
        known = tuple(camera.image for camera in topics), tuple(map(_fingerprint, calibrated))
        if known == self._known:
            return None
        self._known = known
        assembler = self._assembler(calibrated)
        shown = set() if assembler is None else {camera.name for camera in assembler.cameras}
        return LiveCameras(tuple(camera for camera in topics if camera.name in shown), assembler)

    def _assembler(self, cameras: Sequence[RigCamera]) -> FrameAssembler | None:
        """Of the cameras that views can be made of; None where there are none. The others are told of."""
        try:
            return FrameAssembler(cameras, self._width) if cameras else None
        except RigError:
            able = []
            for camera in cameras:
                try:
                    FrameAssembler([camera], self._width)
                    able.append(camera)
                except RigError as error:
                    self._say(f"not shown: {error}")
            return FrameAssembler(able, self._width) if able else None

    def _published(self) -> Sequence[CameraTopics]:
        named = [(self._bus.named(e.topic), e.msgtype) for e in self._endpoints() if e.kind is EntityKind.PUBLISHER]
        types = {topic: msgtype for topic, msgtype in named if topic is not None}
        try:
            return find_cameras(types, "the graph")
        except GraphError:  # nobody publishes images yet; somebody may later
            return ()

    def _calibrated(self, cameras: Sequence[CameraTopics]) -> Sequence[RigCamera]:
        if self._rig is not None:
            published = {camera.name for camera in cameras}
            return [camera for camera in self._rig.cameras if camera.name in published]
        found = [_camera(camera, self._infos, self._tree) for camera in cameras]
        return [camera for camera in found if camera is not None]


def _fingerprint(camera: RigCamera) -> bytes:
    """Of a camera and its calibration: a graph that was started again may have cameras of the same names elsewhere."""
    lens = f"{camera.name} {camera.width} {camera.height} {camera.distortion_model} ".encode()
    return lens + camera.K.tobytes() + camera.D.tobytes() + camera.T_base_cam.tobytes()


def _camera(camera: CameraTopics, infos: Mapping[str, Message], tree: TransformTree) -> RigCamera | None:
    """A camera whose calibration has come, whole and sound; None else."""
    info = infos.get(camera.info)
    if info is None:
        return None
    try:
        T_base_cam = of_pair(info, infos.values(), tree.lookup(info.header.frame_id.lstrip("/")))
        return rig_camera(info, camera.name, T_base_cam, is_rectified=camera.is_rectified)
    except MessageError:  # its transforms have not come yet, or it is not calibrated: there is no place to show it
        return None
