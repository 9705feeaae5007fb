"""Curves over two logarithmic axes, as SVG."""

import html
import math

COLORS = ['#1b6ca8', '#c0392b', '#27823f', '#8e44ad', '#b9770e', '#148f8f', '#7f4f24', '#444444', '#d81b60', '#5c6bc0']
WIDTH, HEIGHT, LEFT, BOTTOM, TOP, RIGHT = 640, 420, 70, 50, 34, 170


def decades(lo, hi):
    return [10.0 ** e for e in range(math.floor(math.log10(lo)), math.ceil(math.log10(hi)) + 1)]


def curves(title, x_label, y_label, lines):
    """`lines`: name -> list of (x, y), all above 0."""
    points = [p for line in lines.values() for p in line]
    xs, ys = decades(min(p[0] for p in points), max(p[0] for p in points)), decades(
        min(p[1] for p in points), max(p[1] for p in points))
    w, h = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM

    def place(values, v, size):
        lo, hi = math.log10(values[0]), math.log10(values[-1])
        return (math.log10(v) - lo) / max(hi - lo, 1e-9) * size

    def px(v):
        return LEFT + place(xs, v, w)

    def py(v):
        return TOP + h - place(ys, v, h)

    out = [f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{HEIGHT}" font-family="sans-serif" font-size="11">',
           f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>',
           f'<text x="{LEFT}" y="20" font-size="14">{html.escape(title)}</text>']
    for v in xs:
        out.append(f'<path d="M{px(v):.1f} {TOP}V{TOP + h}" stroke="#ddd"/>'
                   f'<text x="{px(v):.1f}" y="{TOP + h + 16}" text-anchor="middle">{v:g}</text>')
    for v in ys:
        out.append(f'<path d="M{LEFT} {py(v):.1f}H{LEFT + w}" stroke="#ddd"/>'
                   f'<text x="{LEFT - 6}" y="{py(v) + 4:.1f}" text-anchor="end">{v:g}</text>')
    out.append(f'<text x="{LEFT + w / 2}" y="{HEIGHT - 12}" text-anchor="middle">{html.escape(x_label)}</text>'
               f'<text transform="translate(16 {TOP + h / 2}) rotate(-90)" text-anchor="middle">{html.escape(y_label)}</text>')
    for i, (name, line) in enumerate(lines.items()):
        color = COLORS[i % len(COLORS)]
        dash = '' if i < len(COLORS) else ' stroke-dasharray="4 3"'
        path = 'M' + 'L'.join(f'{px(x):.1f} {py(y):.1f}' for x, y in sorted(line))
        out.append(f'<path d="{path}" fill="none" stroke="{color}" stroke-width="1.6"{dash}/>')
        out += [f'<circle cx="{px(x):.1f}" cy="{py(y):.1f}" r="2.4" fill="{color}"/>' for x, y in line]
        out.append(f'<text x="{LEFT + w + 10}" y="{TOP + 12 + 15 * i}" fill="{color}">{html.escape(name)}</text>')
    return '\n'.join(out + ['</svg>']) + '\n'
