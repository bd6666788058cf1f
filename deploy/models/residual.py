"""The layers of residual blocks that all encoders are made of. The activation is before the addition, unlike
in the common ResNet."""

from winograd import Tiles


def layer(g, x, key, width_in, width, blocks, stride, norm=None, tiled=True):
    """Residual blocks, the first of which may lose resolution or change width.

    `norm` is "batch", "instance" or None; 3x3 convolutions of stride 1 are `tiled` or plain. Between them
    maps stay in tiles, but for instances' means, which are of plain maps.
    """
    tiles = None  # those that maps are in

    def normalised(x, name):
        if norm == "instance":
            return g.instance_norm(x, width)
        if norm == "batch":
            twin = f"{key}.{name[0]}.downsample.1" if name[1] == 3 else None
            return g.batch_norm(x, f"{key}.{name[0]}.bn{name[1]}", width, twin)
        return x

    def conv(x, name, before, step=1):
        full = f"{key}.{name[0]}.conv{name[1]}"
        if tiles:
            of_norm = f"{key}.{name[0]}.bn{name[1]}" if norm else None
            return tiles.clear(g.relu(tiles.conv(x, full, *g.kernel(full, before, width, of_norm))))
        if tiled and step == 1 and before == width:
            x = Tiles(g, x).conv_plain(x, full, *g.kernel(full, width, width))
        else:
            x = g.conv(x, full, before, width, 3, step)
        return g.relu(normalised(x, name))

    for block in range(blocks):
        step, before = (stride, width_in) if block == 0 else (1, width)
        changes = step != 1 or before != width
        stays = tiled and norm != "instance"
        if stays and not tiles and not changes:
            tiles = Tiles(g, x)
            x = tiles.split(x, width)
        y = conv(x, (block, 1), before, step)
        if changes:
            x = normalised(g.conv(x, f"{key}.{block}.downsample.0", before, width, 1, step), (block, 3))
            if stays:
                tiles = Tiles(g, y)
                x, y = tiles.split(x, width), tiles.split(y, width)
        x = g.relu(g.add(x, conv(y, (block, 2), width)))
    return tiles.join(x, width) if tiles else x
