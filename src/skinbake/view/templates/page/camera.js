// A camera that turns around a point: by pointer, touch, wheel and keys.

import { cross, perspective, plus, product, viewFrom } from './matrices.js';

const ANGLE = (32 * Math.PI) / 180;
const STEEPEST = 1.5;
export const CLOSE = 1.3; // What is seen close up, in radii of the place.

export class Camera {
    constructor(element, changed) {
        Object.assign(this, { element, changed, yaw: 0.45, pitch: 0.16, target: [0, 0, 0], facing: 0, distance: 3, radius: 1, closest: 1, size: [1, 1] });
        this.pointers = new Map();
        element.addEventListener('pointerdown', (event) => this.press(event));
        element.addEventListener('pointermove', (event) => this.move(event));
        for (const kind of ['pointerup', 'pointercancel']) element.addEventListener(kind, (event) => this.pointers.delete(event.pointerId));
        element.addEventListener('wheel', (event) => this.wheel(event), { passive: false });
        element.addEventListener('keydown', (event) => this.key(event));
        element.addEventListener('dblclick', () => this.home());
        element.addEventListener('contextmenu', (event) => event.preventDefault());
    }

    // Take the box around all, its middle and half its diagonal, and that of a subject in it. Show the subject.
    // Without a subject, or if it has no size, show all. facing is the direction in which it looks, an angle from +Z.
    frame(middle, radius, subject, facing = 0) {
        Object.assign(this, { middle, radius: radius || 1, facing });
        const seen = subject?.radius > 0 && Number.isFinite(subject.radius) ? subject : this;
        this.closest = seen.radius;
        this.show(seen.middle, seen.radius);
    }

    // Show all.
    home() {
        this.show(this.middle, this.radius);
    }

    show(target, radius, [x, y, z] = [Math.sin(0.45 + this.facing), 0.16, Math.cos(0.45 + this.facing)]) {
        Object.assign(this, { target, yaw: Math.atan2(x, z), pitch: Math.asin(y), shown: radius });
        this.fit();
        this.changed();
    }

    // Show as much as before, in a pane of another size.
    fit() {
        if (this.shown) this.distance = this.fitting(this.shown);
    }

    // size is that of the pane in which it draws.
    fitting(radius) {
        const [width, height] = this.size;
        return (0.98 * radius) / Math.sin(ANGLE / 2) / Math.max(Math.min(1, width / height), 0.45);
    }

    // The same camera before a place, from close up.
    near({ middle, radius }) {
        return Object.assign(Object.create(this), { target: middle, distance: this.fitting(CLOSE * radius) });
    }

    get eye() {
        return plus(this.target, this.axes[2], this.distance);
    }

    // Its right, up and back, as columns.
    get axes() {
        const flat = Math.cos(this.pitch);
        const back = [flat * Math.sin(this.yaw), Math.sin(this.pitch), flat * Math.cos(this.yaw)];
        const right = [Math.cos(this.yaw), 0, -Math.sin(this.yaw)];
        return [right, cross(back, right), back];
    }

    projected(aspect) {
        const near = Math.max(this.distance - 4 * this.radius, this.distance / 200);
        const view = viewFrom(this.eye, this.axes);
        return product(perspective(ANGLE, aspect, near, this.distance + 6 * this.radius), view);
    }

    press(event) {
        this.element.setPointerCapture(event.pointerId);
        this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    }

    move(event) {
        const before = this.pointers.get(event.pointerId);
        if (!before) return;
        const now = [event.clientX, event.clientY];
        const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
        if (this.pointers.size > 1) {
            const other = [...this.pointers].find(([id]) => id !== event.pointerId)[1];
            const far = (point) => Math.hypot(point[0] - other[0], point[1] - other[1]) || 1;
            this.zoom(far(before) / far(now));
            this.pan(dx / 2, dy / 2);
        } else if (event.buttons & 2 || event.shiftKey) this.pan(dx, dy);
        else this.turn(-0.008 * dx, 0.008 * dy);
        this.pointers.set(event.pointerId, now);
        this.changed();
    }

    turn(yaw, pitch) {
        this.shown = null; // From now on it stays where its user puts it.
        this.yaw += yaw;
        this.pitch = Math.max(-STEEPEST, Math.min(STEEPEST, this.pitch + pitch));
    }

    pan(dx, dy) {
        const [side, up] = this.axes;
        const step = (2 * this.distance * Math.tan(ANGLE / 2)) / this.size[1];
        this.shown = null;
        this.target = plus(plus(this.target, side, -dx * step), up, dy * step);
    }

    zoom(factor) {
        this.shown = null;
        this.distance = Math.max(0.02 * this.closest, Math.min(12 * this.radius, this.distance * factor));
    }

    wheel(event) {
        event.preventDefault();
        this.zoom(Math.exp(0.0012 * event.deltaY * (event.deltaMode ? 30 : 1)));
        this.changed();
    }

    key(event) {
        const acts = {
            ArrowLeft: () => this.turn(-0.12, 0),
            ArrowRight: () => this.turn(0.12, 0),
            ArrowUp: () => this.turn(0, 0.12),
            ArrowDown: () => this.turn(0, -0.12),
            '+': () => this.zoom(0.85),
            '=': () => this.zoom(0.85),
            '-': () => this.zoom(1 / 0.85),
            0: () => this.home(),
        };
        if (!acts[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
        event.preventDefault();
        acts[event.key]();
        this.changed();
    }
}
