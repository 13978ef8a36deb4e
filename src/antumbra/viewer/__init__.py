"""The interactive viewer: a browser page fed by the tracer.

- `viewer_page`: `antumbra.view`, the server and its event handlers
- `viewer_model`: scene, time and editable lights, and the frame of the page
- `progressive_pictures`: pictures from coarse to fine, and the thread that traces them
- `proxy_mesh`: the mesh with baked light that the browser shows while the camera moves
- `gizmos`: light handles, and sightlines of a clicked point
- `control_panel`: sliders and text
- `render_words`: the command that renders what a page shows
- `page_html`: our look of viser's page, with `page.css` and `page.mjs`
- `request_guard`: checks of requests to the server

Only `viewer_page` and `request_guard` import viser, when a page opens.
"""
