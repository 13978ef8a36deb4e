"""The control panel of the page: sliders that change the model, and text about pictures and clicked points."""

from asyncio import sleep
from collections.abc import Callable
from datetime import date
from functools import partial
from html import escape
from itertools import count
from typing import Any

from ..picture.png_files import png_file
from ..scene.lights import DirectionalLight
from .gizmos import Face, Probe, Sight, answer_of
from .progressive_pictures import TracedPicture
from .render_words import left_out, render_command
from .viewer_model import BOX_TESTS, LIGHT_SHARE, SHADED, Model, sun_angles

_HINT = "Click or tap a surface to see which lights reach it, and what blocks the others."
_STYLE = "margin: 0 1em; font-size: 0.8em; text-align: left"
_NOWRAP = "white-space: nowrap"
_STOPS = 6.0  # range of the exposure slider, in both directions
_PLAYED_STEP, _PLAYED_SECONDS = 0.25, 0.3  # hours between two pictures of a played day, and seconds


class Controls:
    """The panel.

    page : Page
        Its `changed` is called after each change of the model.

    Attributes
    ----------
    sliders : dict
        The sun's sliders: "bearing" and "elevation"; empty without a sun.
    """

    def __init__(self, page: Any):
        self._page, self._model, self._gui = page, page.model, page.server.gui
        self._sun: Any = None  # the folder of its controls
        self._boxes: dict[str, Any] = {}  # of the lights
        self._commands: dict[int, Any] = {}  # browser -> the command that it copied
        self._numbers = count(1)  # of these commands
        self.sliders: dict[str, Any] = {}
        self._status = self._gui.add_markdown("Preparing the first picture ...")
        self._legend: Any = None
        self._add_point()
        if self._model.scene.animated:
            self._add_time()
        if self._model.sun is not None:
            self._add_sun()
        self._add_picture()
        self._add_lights()

    def show_picture(self, picture: TracedPicture) -> None:
        """Describe the picture that the browser shows."""
        speed = picture.rays / max(picture.seconds, 1e-9) / 1e6
        rate = f", {speed:.1f} million rays/s" if speed >= 0.05 else ""  # coarse pictures trace few
        text = f"{picture.step}: {1000 * picture.seconds:.0f} ms{rate}{picture.cost}"
        self.say(f"{text}; {picture.note}" if picture.note else text)
        if self._legend is not None:
            self._legend.remove()
            self._legend = None
        if picture.legend is not None:
            self._legend = self._gui.add_image(picture.legend, format="png", order=0.5)

    def say(self, text: str) -> None:
        """Show a line at the top of the panel."""
        self._status.content = text

    def describe(self, point: Probe | None) -> None:
        """Show what a clicked point sees."""
        self._point.content = describe_point(point, self._model)

    def refresh(self) -> None:
        """Set the sliders from the model, and say which lights have set."""
        for lamp in self._model.editable_lights:
            label = f"{lamp.name} (has set)" if self._model.has_set(lamp) else lamp.name
            if lamp.name in self._boxes and self._boxes[lamp.name].label != label:
                self._boxes[lamp.name].label = label
        if self._sun is not None:
            self._sun.visible = self._model.sun.on
        sun = self._model.sun
        if sun is not None and "elevation" in self.sliders:
            bearing, elevation = sun_angles(sun.light, self._model.scene.up)
            for name, value in ("bearing", bearing), ("elevation", elevation):
                value = round(value, 1)
                if abs(self.sliders[name].value - value) > 0.1:
                    self.sliders[name].value = value

    def _add_point(self) -> None:
        with self._gui.add_folder("Point"):
            self._point = self._gui.add_html(describe_point(None, self._model))

    def _add_picture(self) -> None:
        model, gui = self._model, self._gui
        kinds = [SHADED, *(LIGHT_SHARE + lamp.name for lamp in model.editable_lights), BOX_TESTS]
        with gui.add_folder("Picture"):
            show = gui.add_dropdown("Show", kinds, initial_value=model.display.show)
            plan = gui.add_text("Plan", model.display.plan, hint="The plan whose box tests are shown", visible=False)
            stops = gui.add_slider(
                "Exposure", -_STOPS, _STOPS, 0.1, 0.0, hint="In stops, relative to the automatic exposure"
            )
            actions = {
                "Reset view": self._reset_view,
                "Reset exposure": self._reset_exposure,
                "Copy view": self._copy_view,
                "Save": self._save,
            }
            buttons = gui.add_button_group("", list(actions))
        self._stops = stops

        def show_kind(kind: str) -> None:
            plan.visible = kind == BOX_TESTS
            self._set_display(show=kind)

        self._bind(show, show_kind)
        self._bind(plan, lambda value: self._set_display(plan=value))
        self._bind(stops, lambda value: self._set_display(stops=value))

        async def act(event: Any) -> None:
            actions[event.target.value](event.client)

        buttons.on_click(self._page.listener(act))

    def _reset_view(self, client: Any) -> None:
        self._page.show_first_view(client.client_id, client.camera)

    def _reset_exposure(self, client: Any) -> None:
        self._model.reset_exposure()
        self._stops.value = 0.0
        self._page.changed()

    def _copy_view(self, client: Any) -> None:
        """Show the command that renders this view; the script of the page copies it."""
        camera = self._page.camera_of(client.client_id)
        if camera is None:
            return
        if old := self._commands.pop(client.client_id, None):
            old.remove()
        text = escape(render_command(self._model, camera))
        code = f"<code data-copy='{next(self._numbers)}' style='overflow-wrap: anywhere'>{text}</code>"
        missing = left_out(self._model)
        note = f"<br>It leaves out {escape(', '.join(missing))}." if missing else ""
        html = f"<div style='{_STYLE}'><output></output><br>{code}{note}</div>"
        self._commands[client.client_id] = client.gui.add_html(html, order=0.4)

    def forget(self, client_id: int) -> None:
        """Drop what belongs to a browser that has disconnected."""
        self._commands.pop(client_id, None)

    def _save(self, client: Any) -> None:
        picture = self._page.latest(client.client_id)
        if picture is not None:
            name = f"{self._model.scene.name}.png"
            client.send_file_download(name, png_file(picture.image), save_immediately=True)

    def _add_time(self) -> None:
        model = self._model
        with self._gui.add_folder("Time"):
            length = model.scene.duration
            slider = self._gui.add_slider("Seconds", 0.0, length, length / 1000.0, model.time)
        self._bind(slider, model.go_to)

    def _add_sun(self) -> None:
        model, gui, sliders = self._model, self._gui, self.sliders
        assert isinstance(model.sun.light, DirectionalLight)
        bearing, elevation = sun_angles(model.sun.light, model.scene.up)
        self._sun = gui.add_folder("Sun")
        with self._sun:
            if model.place is not None:
                self._add_day()
                bearing, elevation = sun_angles(model.sun.light, model.scene.up)
            hint = "Degrees clockwise from the scene's north, which is +Y if +Z is up, and -Z otherwise"
            above = "Degrees above the horizon"
            sliders["bearing"] = gui.add_slider("Bearing", 0.0, 360.0, 0.5, round(bearing, 1), hint=hint)
            sliders["elevation"] = gui.add_slider("Elevation", -90.0, 90.0, 0.5, round(elevation, 1), hint=above)
        aim = lambda _: model.aim_sun(sliders["bearing"].value, sliders["elevation"].value)
        self._bind(sliders["bearing"], aim)
        self._bind(sliders["elevation"], aim)

    def _add_day(self) -> None:
        """Date, hour and a button that plays the day. The first sun is theirs, unless other lights are given."""
        model, gui = self._model, self._gui
        today = date.today().isoformat()
        hours = model.daylight(today, _PLAYED_STEP) or [12.0]
        day = gui.add_text("Day", today, hint="Such as 2026-06-21")
        hour = gui.add_slider("Hour", 0.0, 24.0, 0.05, hours[len(hours) * 3 // 4])  # shadows are long, and move on
        play = gui.add_button("Play the day")
        if model.follows_sun:
            model.aim_sun_at(day.value, hour.value)
        for each in day, hour:
            self._bind(each, lambda _: model.aim_sun_at(day.value, hour.value))

        async def play_day(event: Any) -> None:
            play.disabled = True
            try:
                for moment in model.daylight(day.value, _PLAYED_STEP):
                    hour.value = moment
                    model.aim_sun_at(day.value, moment)
                    self._page.changed()
                    await sleep(_PLAYED_SECONDS)
            finally:
                play.disabled = False

        play.on_click(self._page.listener(play_day))

    def _add_lights(self) -> None:
        model = self._model
        with self._gui.add_folder("Lights"):
            handles = self._gui.add_checkbox("Show handles", True)
            self._boxes = {lamp.name: self._gui.add_checkbox(lamp.name, lamp.on) for lamp in model.editable_lights}
        for name, box in self._boxes.items():
            self._bind(box, partial(model.switch, name))

        async def show_handles(event: Any) -> None:
            self._page.gizmos.show_handles(handles.value)

        handles.on_update(self._page.listener(show_handles))

    def _set_display(self, **changes: Any) -> None:
        self._model.display = self._model.display._replace(**changes)

    def _bind(self, control: Any, change: Callable[[Any], Any]) -> None:
        """Change the model whenever the user, rather than this program, moves a control."""

        async def update(event: Any) -> None:
            if event.client is not None:
                change(control.value)
                self._page.changed()

        control.on_update(self._page.listener(update))


def describe_point(point: Probe | None, model: Model) -> str:
    """HTML about a point of the model's scene: its surface, and a row per light."""
    if point is None:
        return f"<div style='{_STYLE}'>{_HINT}</div>"
    rows = "".join(
        f"<tr><td>{escape(sight.name)}</td><td style='{_NOWRAP}'>{100.0 * sight.share:.3g} % of {sight.samples}</td>"
        f"<td>{_blocked(sight)}</td></tr>"
        for sight in point.sights
    )
    head = "<tr><th>Light</th><th>Visible</th><th>Centre</th></tr>"
    table = f"<table style='border-spacing: 0.5em 0.1em; margin-left: -0.5em'>{head}{rows}</table>"
    place = model.text_of(point.position)
    return f"<div style='{_STYLE}'>{escape(answer_of(point))}<br>{_face(point.face)}, at {place}{table}</div>"


def _blocked(sight: Sight) -> str:
    if sight.end is None:
        return "none"
    return "visible" if sight.blocker is None else f"behind {_face(sight.blocker)}"


def _face(face: Face) -> str:
    return f"face {face.index:,}" + (f" of {escape(face.object)}" if face.object else "")
