# An animation
#
# Twelve frames of a mill, from one command that continues where it was interrupted. All frames share one exposure.
antumbra render example:mill --frames 0:33:3 --fps 48 --size 320x240 --preset final -o mill.##.png
python -c "
from PIL import Image
sheet = Image.new('RGB', (1280, 720))
for k in range(12):
    sheet.paste(Image.open(f'mill.{3 * k:02}.png').resize((320, 240)), (k % 4 * 320, k // 4 * 240))
sheet.save('animation.png')"
