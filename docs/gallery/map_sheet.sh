# A map sheet
#
# Sun hours in a city at the equinox, at 1:1000 on A4, with a title block. As .pdf, it has further pages.
antumbra sun "procedural:city?triangles=20k" --latitude 52 --longitude 4.36 --timezone Europe/Amsterdam \
    --days 2026-03-21 --sensors raster:1 --step 30 --map map_sheet.png --sheet orientation=landscape \
    --sheet title="Hours of sun on 21 March" --sheet project="River Street 5" --sheet author="A. Planner"
