"""Sun hours: which sensors see the sun, and when; and how much of the sky they see.

- `sun_hours`: `sun_hours` and `sky_view`
- `sun_options`: options of `sun_hours`, with their checks
- `solar_radiation`: weather and clear skies; `epw_file`: EPW files
- `daylight_rules`: rules, with their clauses; `rule_verdicts`: scores of suns, and verdicts on tables
- `overcast_sky`: the vertical sky component
- `route_shade`: shade along a route by hour
- `sun_calendar`: first and last sun of each day; `calendar_diagram`: its sheet
- `route_options`: options of these two
- `sun_visibility`: visible suns of each sensor
- `sun_tally`: sums over visible suns
"""
