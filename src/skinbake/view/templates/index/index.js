// Sort the files by a column, and the other way round when it is chosen again.

const table = document.querySelector('table');
const body = table.tBodies[0];
const heads = [...table.tHead.rows[0].cells];

heads.forEach((head, column) => {
    head.querySelector('button').addEventListener('click', () => {
        const isNumber = head.classList.contains('number');
        const before = head.getAttribute('aria-sort');
        const way = before === 'ascending' || (!before && isNumber) ? 'descending' : 'ascending';
        for (const other of heads) other.removeAttribute('aria-sort');
        head.setAttribute('aria-sort', way);
        const sign = way === 'ascending' ? 1 : -1;
        const key = (row) => row.cells[column].dataset.value ?? row.cells[column].textContent;
        const compare = (a, b) => (isNumber ? Number(key(a)) - Number(key(b)) : key(a).localeCompare(key(b)));
        body.append(...[...body.rows].sort((a, b) => sign * compare(a, b)));
    });
});
