// What skinbake verify has measured, beside the model. Every text of a file goes in as text.

const ROWS = [
    ['lbs', 'standard', 'Standard'],
    ['lbs', 'corrected', 'Corrected by targets'],
    ['lbs', 'accurate', 'Accurate'],
    ['dqs', 'standard', 'Dual quaternions, standard'],
    ['dqs', 'accurate', 'Dual quaternions, accurate'],
    ['dqs', 'exact', 'Dual quaternions, exact'],
    ['blend', 'standard', 'Between both, standard'],
    ['blend', 'accurate', 'Between both, accurate'],
];

export function showFigures(byId, given) {
    const { by_triangles: triangles, by_tangents: tangents, poses, verdict } = given;
    const [first, other] = byTruth(triangles, tangents).filter(({ gain }) => gain);
    byId.headline.hidden = !verdict && !first;
    byId.gain.textContent = verdict?.words ?? '';
    byId.gain.classList.toggle('is-good', Boolean(verdict?.isGood));
    byId['gain-words'].textContent = verdict?.remark ?? '';
    const measured = { ...triangles, ...tangents };
    const isMeasured = Object.keys(measured).length > 0;
    byId.table.parentElement.hidden = !isMeasured;
    if (!isMeasured) return;
    if (first) {
        const name = first.corrected ? 'Corrected' : 'Accurate';
        const how = measured.lbs ? '' : measured.dqs ? ', with dual quaternions' : ', blended with dual quaternions';
        byId['gain-words'].textContent =
            `${name} lighting is off by ${degrees(bakedOf(first).mean)} in the mean, standard lighting by ${degrees(first.standard.mean)}${how}: ` +
            `a gain of ${times(first.gain)} ${first.truth}${other ? `, of ${times(other.gain)} ${other.truth}` : ''}. ` +
            'By triangles: true normals are those of the deformed triangles. By tangents: they stand on the deformed tangents.';
    }
    byId.table.replaceChildren(tableOf(triangles, tangents));
    byId['table-words'].textContent = `By skinbake verify, over ${poses}. Two truths, found in two ways.`;
}

// What the bake of a file gives: its correctives, or α and β.
const bakedOf = ({ corrected, accurate }) => corrected ?? accurate;

// The figures of the first method by both truths, as far as there are any.
function byTruth(triangles, tangents) {
    return [
        { truth: 'by triangles', ...(triangles?.lbs ?? triangles?.dqs ?? triangles?.blend) },
        { truth: 'by tangents', ...(tangents?.lbs ?? tangents?.dqs ?? tangents?.blend) },
    ].filter(({ standard }) => standard);
}

function tableOf(triangles, tangents) {
    const table = element('table');
    const head = element('thead');
    head.append(row('th', ['', 'mean', 'p95', 'mean', 'p95']));
    const above = element('tr');
    for (const [text, span] of [['', 1], ['by triangles', 2], ['by tangents', 2]]) {
        const cell = element(text ? 'th' : 'td', text);
        cell.colSpan = span;
        if (text) cell.scope = 'colgroup';
        above.append(cell);
    }
    head.prepend(above);
    const body = element('tbody');
    for (const [method, lighting, name] of ROWS) {
        const one = triangles?.[method]?.[lighting];
        const other = tangents?.[method]?.[lighting];
        if (!one && !other) continue;
        const cells = [one?.mean, one?.p95, other?.mean, other?.p95].map((value) => (value === undefined ? '—' : value.toFixed(2)));
        const line = row('td', cells);
        const title = element('th', name);
        title.scope = 'row';
        line.prepend(title);
        body.append(line);
    }
    table.append(head, body);
    return table;
}

export function showNotes(byId, given) {
    const checks = given.checks ?? [];
    byId.limits.textContent = given.limits?.length ? `Limits: ${given.limits.join(', ')}.` : '';
    byId.verdict.textContent = given.limits ? given.outcome : '';
    if (given.limits) byId.checks.parentElement.prepend(byId.checks); // A report begins with its verdict.
    byId.verdict.className = `outcome is-${given.outcome}`;
    showPrimitives(byId, given.primitives ?? []);
    byId.checks.hidden = !checks.length;
    byId['checks-list'].replaceChildren(
        ...checks.map(({ name, outcome, remark, problems }) => {
            const item = element('li');
            const word = element('span', outcome);
            word.className = `outcome is-${outcome}`;
            item.append(`${name}: `, word, remark && !problems.length ? ` — ${remark}` : '');
            for (const problem of problems) item.append(element('p', problem));
            return item;
        })
    );
    const notes = given.notes ?? [];
    byId.notes.hidden = !notes.length;
    byId['notes-list'].replaceChildren(...notes.map((text) => element('li', text)));
}

// The figures of each primitive, where there are several.
function showPrimitives(byId, primitives) {
    const figuresOf = (one) => byTruth(one.normals_by_triangles, one.normals_by_tangents)[0];
    const rows = primitives.filter(figuresOf);
    byId.primitives.hidden = rows.length < 2;
    const table = element('table');
    const head = element('thead');
    const isCorrected = rows.some((one) => figuresOf(one).corrected);
    head.append(row('th', ['', 'standard', isCorrected ? 'corrected' : 'accurate', 'gain']));
    const body = element('tbody');
    for (const given of rows) {
        const { mesh, mesh_name: name, primitive } = given;
        const one = figuresOf(given);
        const { standard, gain } = one;
        const line = row('td', [standard.mean.toFixed(2), bakedOf(one).mean.toFixed(2), gain ? times(gain) : '—']);
        const title = element('th', `${isolated(name ?? `mesh ${mesh}`)}, ${primitive}`);
        title.scope = 'row';
        line.prepend(title);
        body.append(line);
    }
    table.append(head, body);
    byId['primitives-table'].replaceChildren(table);
}

// A name in a sentence. Its letters may run from right to left, and do not turn the words after it around.
export const isolated = (name) => `\u2068${name}\u2069`;

// A loss has up to four decimals, and is never 1.00: as in the text of skinbake verify.
function times(gain) {
    if (gain >= 100) return `${Math.round(gain).toLocaleString('en')}×`;
    const shown = gain < 1 ? Math.min(gain, 0.9999) : gain;
    let decimals = 2;
    while (gain < 1 && Number(shown.toFixed(decimals)) === 1) decimals += 1;
    return `${shown.toFixed(decimals)}×`;
}

export const degrees = (value) => (value < 10 ? `${value.toFixed(2)}°` : `${value.toFixed(1)}°`);

function row(kind, texts) {
    const made = element('tr');
    for (const text of texts) {
        const cell = element(text ? kind : 'td', text);
        if (text && kind === 'th') cell.scope = 'col';
        made.append(cell);
    }
    return made;
}

function element(name, text = '') {
    const made = document.createElement(name);
    made.textContent = text;
    return made;
}
