# An animation
#
# A mill turns, in frames from one command that continues where it was interrupted. All frames share one exposure. Named
# `-o mill.mp4`, the command writes a film by itself.
antumbra render example:mill --frames 0:48 --fps 12 --size 480x300 --preset final -o mill.##.png
python -c "
from PIL import Image
frames = [Image.open(f'mill.{k:02}.png').convert('RGB') for k in range(48)]
frames[0].save('animation.webp', save_all=True, append_images=frames[1:], duration=83, loop=0, quality=70, method=6)"
