"""Reads what the benchmark has written: OpenEXR, scan lines, no compression, 32-bit floats."""

import array
import struct


def read(path):
    """Width, height and the channels, each a list of rows from the top left."""
    data = open(path, 'rb').read()
    if data[:4] != b'\x76\x2f\x31\x01':
        raise ValueError(f'{path}: not an OpenEXR file')
    at, attributes = 8, {}
    while data[at]:
        end = data.index(0, at)
        name, at = data[at:end].decode(), end + 1
        end = data.index(0, at)
        at = end + 1
        size = struct.unpack_from('<i', data, at)[0]
        attributes[name] = data[at + 4:at + 4 + size]
        at += 4 + size
    at += 1
    if attributes['compression'] != b'\0':
        raise ValueError(f'{path}: compressed')
    x0, y0, x1, y1 = struct.unpack('<4i', attributes['dataWindow'])
    width, height = x1 - x0 + 1, y1 - y0 + 1
    names, text = [], attributes['channels']
    while text[0]:
        end = text.index(0)
        names.append(text[:end].decode())
        if struct.unpack_from('<i', text, end + 1)[0] != 2:
            raise ValueError(f'{path}: channel {names[-1]} is not float')
        text = text[end + 17:]
    channels = {name: [0.0] * (width * height) for name in names}
    for row in range(height):
        offset = struct.unpack_from('<Q', data, at + 8 * row)[0]
        y = struct.unpack_from('<i', data, offset)[0] - y0
        for k, name in enumerate(names):
            values = array.array('f')
            start = offset + 8 + 4 * width * k
            values.frombytes(data[start:start + 4 * width])
            channels[name][y * width:(y + 1) * width] = values
    return width, height, channels
