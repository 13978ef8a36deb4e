"""The interactive viewer: a page in the browser, fed by the tracer.

- model: what is shown: scene, time, lights; every change of it gets a number
- lamps: lights that can be moved, turned and switched off
- stage: the frame of the page, in which every scene is twenty units wide
- pictures: traced pictures, from coarse to fine; heat: the box tests of a plan, in colours
- probe: what a point sees, and what blocks it
- standin: a mesh with baked light that the browser shows while the camera moves; glb: its file
- worker: one thread that traces, for all that ask
- guard: which requests reach the server
- page: the server, its clients and their pictures; controls: the panel; marks: handles of lights, and clicked points
- show: `antumbra.view`

Everything above `guard` knows no browser. viser is imported when a page opens.
"""
