# Sun hours in June
#
# Hours of direct sun on every surface of a city on a day in June, in false colours. It needs `pip install
# 'antumbra[sun]'`.
antumbra sun "procedural:city?triangles=100k" --latitude 52 --longitude 4.36 --timezone Europe/Amsterdam \
    --days 2026-06-21 --step 30 --sensors grid:0.5 -o sun_city.png
