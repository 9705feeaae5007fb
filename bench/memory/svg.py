"""Charts as SVG text: lines over a common x axis, and bars. No dependencies."""

COLORS = ['#1f6fb4', '#d1495b', '#3a8f5c', '#8a5fb0', '#c98a1b', '#444444']
WIDTH, HEIGHT = 760, 380
LEFT, RIGHT, TOP, BOTTOM = 74, 20, 44, 52


def escape(text):
    return str(text).replace('&', '&amp;').replace('<', '&lt;').replace('>', '&gt;')


def nice_step(span, parts):
    """A round number near span / parts: 1, 2 or 5 times a power of ten."""
    if span <= 0:
        return 1
    power = 1.0
    while power * 10 <= span / parts:
        power *= 10
    while power > span / parts:
        power /= 10
    for factor in (1, 2, 5, 10):
        if power * factor >= span / parts:
            return power * factor
    return power * 10


def number(value):
    return f'{value:.10g}' if abs(value - round(value)) > 1e-9 else str(int(round(value)))


class Chart:
    def __init__(self, title, x_label, y_label, x_max, y_max, log2_x=False):
        self.x_max, self.y_max, self.log2_x = max(x_max, 1e-9), max(y_max, 1e-9), log2_x
        self.parts = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif" font-size="13">',
            f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>',
            f'<text x="{LEFT}" y="20" font-size="15">{escape(title)}</text>',
            f'<text x="{(LEFT + WIDTH - RIGHT) / 2}" y="{HEIGHT - 10}" text-anchor="middle">{escape(x_label)}</text>',
            f'<text transform="translate(16 {(TOP + HEIGHT - BOTTOM) / 2}) rotate(-90)" text-anchor="middle">{escape(y_label)}</text>',
        ]
        step = nice_step(self.y_max, 5)
        value = 0.0
        while value <= self.y_max * 1.0001:
            y = self.y(value)
            self.parts.append(f'<line x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y:.1f}" y2="{y:.1f}" stroke="#ddd"/>')
            self.parts.append(f'<text x="{LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{number(value)}</text>')
            value += step

    def x(self, value):
        return LEFT + (WIDTH - RIGHT - LEFT) * value / self.x_max

    def y(self, value):
        return HEIGHT - BOTTOM - (HEIGHT - BOTTOM - TOP) * value / self.y_max

    def text(self):
        return '\n'.join(self.parts + ['</svg>']) + '\n'


def lines(title, x_label, y_label, series, goal=None):
    """series: {name: [(x, y), ...]}. goal: (name, y), a dashed line."""
    points = [p for s in series.values() for p in s]
    x_max = max((p[0] for p in points), default=1)
    y_max = max([p[1] for p in points] + ([goal[1]] if goal else []), default=1) * 1.05
    chart = Chart(title, x_label, y_label, x_max, y_max)
    step, value = nice_step(x_max, 8), 0.0
    while value <= x_max * 1.0001:
        chart.parts.append(f'<text x="{chart.x(value):.1f}" y="{HEIGHT - BOTTOM + 18}" text-anchor="middle">{number(value)}</text>')
        value += step
    for i, (name, data) in enumerate(series.items()):
        path = ' '.join(f'{chart.x(a):.1f},{chart.y(b):.1f}' for a, b in data)
        color = COLORS[i % len(COLORS)]
        chart.parts.append(f'<polyline points="{path}" fill="none" stroke="{color}" stroke-width="2"/>')
        chart.parts.append(f'<text x="{LEFT + 8 + 220 * (i % 3)}" y="{TOP - 8 + 16 * (i // 3)}" fill="{color}">{escape(name)}</text>')
    if goal:
        y = chart.y(goal[1])
        chart.parts.append(f'<line x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y:.1f}" y2="{y:.1f}" stroke="#888" stroke-dasharray="6 4"/>')
        chart.parts.append(f'<text x="{WIDTH - RIGHT}" y="{y - 5:.1f}" text-anchor="end" fill="#666">{escape(goal[0])}</text>')
    return chart.text()


def bars(title, y_label, groups, goal=None):
    """groups: {label: {series: value}}; stacked from below."""
    names = []
    for group in groups.values():
        names += [n for n in group if n not in names]
    y_max = max([sum(g.values()) for g in groups.values()] + ([goal[1]] if goal else []), default=1) * 1.08
    chart = Chart(title, '', y_label, 1, y_max)
    room = (WIDTH - RIGHT - LEFT) / max(len(groups), 1)
    for i, (label, group) in enumerate(groups.items()):
        low = 0.0
        for name, value in group.items():
            y = chart.y(low + value)
            chart.parts.append(f'<rect x="{LEFT + room * (i + 0.15):.1f}" width="{room * 0.7:.1f}" y="{y:.1f}" '
                               f'height="{chart.y(low) - y:.1f}" fill="{COLORS[names.index(name) % len(COLORS)]}"/>')
            low += value
        x = LEFT + room * (i + 0.5)
        chart.parts.append(f'<text x="{x:.1f}" y="{chart.y(low) - 4:.1f}" text-anchor="middle" font-size="11">{low:.3g}</text>')
        for row, part in enumerate(label.split(' ', 1) if room < 110 else [label]):
            chart.parts.append(f'<text x="{x:.1f}" y="{HEIGHT - BOTTOM + 16 + 13 * row}" text-anchor="middle" font-size="11">{escape(part)}</text>')
    for i, name in enumerate(names):
        chart.parts.append(f'<text x="{LEFT + 8 + 110 * i}" y="{TOP - 8}" fill="{COLORS[i % len(COLORS)]}">{escape(name)}</text>')
    if goal:
        y = chart.y(goal[1])
        chart.parts.append(f'<line x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y:.1f}" y2="{y:.1f}" stroke="#888" stroke-dasharray="6 4"/>')
        chart.parts.append(f'<text x="{WIDTH - RIGHT}" y="{y - 5:.1f}" text-anchor="end" fill="#666">{escape(goal[0])}</text>')
    return chart.text()
