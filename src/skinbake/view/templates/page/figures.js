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
    const measured = { ...triangles, ...tangents };
    const isMeasured = Object.keys(measured).length > 0;
    byId.table.parentElement.hidden = !isMeasured;
    const how = measured.lbs ? '' : measured.dqs ? ', with dual quaternions' : ', blended with dual quaternions';
    const gains = first && `${first.corrected ? 'Corrected' : 'Accurate'} lighting is off by ${degrees(bakedOf(first).mean)} in the mean, standard ` +
        `lighting by ${degrees(first.standard.mean)}${how}: a gain of ${times(first.gain)} ${first.truth}${other ? `, of ${times(other.gain)} ${other.truth}` : ''}.`;
    const explained = 'By triangles: true normals are those of the deformed triangles. By tangents: they stand on the deformed tangents.';
    byId['gain-words'].textContent = `${gains ?? verdict?.remark ?? ''} ${isMeasured ? explained : ''}`;
    if (!isMeasured) return;
    const lines = ROWS.flatMap(([method, lighting, name]) => {
        const [one, other] = [triangles, tangents].map((truth) => truth?.[method]?.[lighting]);
        const cells = [one?.mean, one?.p95, other?.mean, other?.p95].map((value) => (value === undefined ? '—' : value.toFixed(2)));
        return one || other ? [[name, ...cells]] : [];
    });
    const heads = [[[''], ['by triangles', 2], ['by tangents', 2]], [[''], ['mean'], ['p95'], ['mean'], ['p95']]];
    byId.table.replaceChildren(tableOf(heads, lines));
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

// A table. Heads are rows of texts, some with the number of columns that they span. Lines begin with their title.
function tableOf(heads, lines) {
    const [table, head, body] = ['table', 'thead', 'tbody'].map((name) => element(name));
    const cell = (text, scope, colSpan = 1) => Object.assign(element(text && scope ? 'th' : 'td', text), text && scope ? { scope, colSpan } : {});
    const rowOf = (cells) => {
        const row = element('tr');
        row.append(...cells);
        return row;
    };
    head.append(...heads.map((texts) => rowOf(texts.map(([text, span]) => cell(text, span ? 'colgroup' : 'col', span)))));
    body.append(...lines.map(([title, ...texts]) => rowOf([cell(title, 'row'), ...texts.map((text) => cell(text))])));
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
    const baked = rows.some((one) => figuresOf(one).corrected) ? 'corrected' : 'accurate';
    const lines = rows.map((given) => {
        const { mesh, mesh_name: name, primitive } = given;
        const one = figuresOf(given);
        const title = `${isolated(name ?? `mesh ${mesh}`)}, ${primitive}`;
        return [title, one.standard.mean.toFixed(2), bakedOf(one).mean.toFixed(2), one.gain ? times(one.gain) : '—'];
    });
    byId['primitives-table'].replaceChildren(tableOf([[[''], ['standard'], [baked], ['gain']]], lines));
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

function element(name, text = '') {
    const made = document.createElement(name);
    made.textContent = text;
    return made;
}
