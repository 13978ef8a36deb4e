"""What the default pictures of scenes show: all of a scene from outside, or the room that it encloses from inside."""

from ..scene.data import SceneData
from ..scene.memory import MemoryData
from ..scene.sampled import detail, moving_faces, sampled_faces, within
from ..scene.view import View, view_of_box
from .room import room_of


def view_of(data: SceneData) -> View:
    """The geometry that a default picture of a scene shows; of a scene in a store only the bounds are known."""
    if not isinstance(data, MemoryData):
        return view_of_box(data.bounds, data.up)
    faces = moving_faces(data.source, data.n_triangles)
    box = detail(faces)
    view = View(within(faces, box), data.up, None)
    room = room_of(data, view.camera(1, 1), box)
    return view._replace(room=room, points=view.points if room is None or room.points is None else room.points)


def view_at(data: SceneData, view: View, time: float) -> View:
    """The view of a moment of a scene whose view is known."""
    if not isinstance(data, MemoryData) or not data.animated or view.room is not None:
        return view
    faces = sampled_faces(data.source, data.n_triangles, time)
    return view._replace(points=within(faces, detail(faces)))
