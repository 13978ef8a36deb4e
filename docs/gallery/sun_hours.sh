# Sun hours in Delft
#
# Hours of direct sun on 21 March, on a grid over all surfaces of a part of Delft. It needs `pip install
# 'antumbra[sun]'`.
antumbra sun delft_city.glb --up z --latitude 52.0116 --longitude 4.3571 --north 0.81 --timezone Europe/Amsterdam \
    --days 2026-03-21 --step 15 --sensors grid:0.5 -o sun_hours.png
