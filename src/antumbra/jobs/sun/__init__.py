"""Sun hours: which sensors see the sun, and when; and how much of the sky they see (`sky`).

- place: position, and the direction of true north in the scene
- zones: time zones; times: intervals of days in them; weather: intervals and radiation of EPW files, and of a clear sky
- positions: the sun of each interval
- rules: daylight rules about hours of sun
"""
