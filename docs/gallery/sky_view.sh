# Sky view
#
# The share of a uniform sky that arrives on each surface, which streets and courtyards do not see whole.
antumbra sun "procedural:city?triangles=200k" --latitude 52 --longitude 4.36 --days 2026-06-21 \
    --sensors grid:0.5 --sky 256 --column sky_view -o sky_view.png
