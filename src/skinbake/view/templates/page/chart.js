// The error of each lighting over a clip, as lines. Pointing at it shows the pose.

const SVG = 'http://www.w3.org/2000/svg';
const [LEFT, BOTTOM, TOP] = [30, 20, 6];

export class Chart {
    // look is called with a time, and with whether it is to stay.
    constructor(element, key, words, look) {
        Object.assign(this, { element, key, words, look, lines: {}, shown: [], names: {}, expected: 10 });
        element.addEventListener('pointermove', (event) => this.point(event, false));
        element.addEventListener('pointerdown', (event) => this.point(event, true));
        element.addEventListener('pointerleave', () => this.look(null, false));
        new ResizeObserver(() => this.redraw()).observe(element);
    }

    // lines hold the means by lighting, with times. A mean is undefined while it is not known, and null if there is none.
    set(clip, times, lines, shown, names) {
        Object.assign(this, { clip, times, lines, shown, names });
        this.redraw();
    }

    redraw() {
        const { element, clip, times, lines, shown } = this;
        if (!clip || !times) return;
        const [width, height] = [element.clientWidth, element.clientHeight];
        const known = shown.flatMap((lighting) => lines[lighting].filter(isKnown));
        this.most = nice(Math.max(0.1, ...(known.length ? known : [this.expected])));
        this.x = (time) => LEFT + ((time - clip.start) / (clip.end - clip.start || 1)) * (width - LEFT - 2);
        const y = (mean) => TOP + (1 - mean / this.most) * (height - TOP - BOTTOM);
        const svg = make('svg', { 'aria-hidden': 'true' });
        for (const share of [0, 0.5, 1]) {
            const at = y(share * this.most);
            svg.append(make('line', { class: 'grid', x1: LEFT, x2: width, y1: at, y2: at }));
            svg.append(label(`${short(share * this.most)}°`, LEFT - 6, at + 4, 'end'));
        }
        svg.append(label(`${clip.start.toFixed(1)} s`, LEFT, height - 4, 'start'));
        svg.append(label(`${clip.end.toFixed(1)} s`, width - 2, height - 4, 'end'));
        for (const lighting of shown) {
            const points = times.flatMap((time, i) => (isKnown(lines[lighting][i]) ? [`${this.x(time)},${y(lines[lighting][i])}`] : []));
            svg.append(make('polyline', { class: `line is-${lighting}`, points: points.join(' ') }));
        }
        this.now = make('line', { class: 'now', y1: TOP, y2: height - BOTTOM });
        svg.append(this.now);
        element.replaceChildren(svg);
        const keyOf = (lighting) => Object.assign(document.createElement('span'), { className: `is-${lighting}`, textContent: this.names[lighting] });
        this.key.replaceChildren(...shown.map(keyOf));
        this.setTime(this.time ?? clip.start);
    }

    setTime(time) {
        this.time = time;
        if (!this.now) return;
        for (const end of ['x1', 'x2']) this.now.setAttribute(end, this.x(time));
    }

    // The mean of a lighting at a time, between the samples around it: undefined until both are measured, null without a mean.
    at(lighting, time) {
        const { times, lines } = this;
        const means = lines[lighting];
        if (!times || !means) return undefined;
        const low = times.findLastIndex((one, i) => means[i] !== undefined && one <= time);
        const high = times.findIndex((one, i) => means[i] !== undefined && one > time);
        if (low === means.length - 1) return means[low];
        if (low < 0 || high < 0) return undefined;
        if (!isKnown(means[low]) || !isKnown(means[high])) return means[low] ?? means[high];
        return means[low] + ((means[high] - means[low]) * (time - times[low])) / (times[high] - times[low]);
    }

    point(event, stays) {
        const { clip, element } = this;
        if (!clip) return;
        const { left, width } = element.getBoundingClientRect();
        const share = (event.clientX - left - LEFT) / (width - LEFT - 2);
        this.look(clip.start + Math.max(0, Math.min(1, share)) * (clip.end - clip.start), stays);
    }
}

export const isKnown = (mean) => mean !== undefined && mean !== null;

function make(name, attributes) {
    const made = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    return made;
}

function label(text, x, y, anchor) {
    const made = make('text', { x, y, 'text-anchor': anchor });
    made.textContent = text;
    return made;
}

// The next number above that reads well at the top of an axis.
function nice(value) {
    const power = 10 ** Math.floor(Math.log10(value));
    return [1, 2, 3, 4, 6, 8, 10].find((step) => step * power >= value * 0.999) * power;
}

const short = (value) => String(Number(value.toPrecision(2)));
