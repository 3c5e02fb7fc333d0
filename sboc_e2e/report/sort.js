"use strict";
(() => {
  for (const table of document.querySelectorAll("table.sortable")) table.querySelectorAll("th").forEach((head, column) => {
    head.tabIndex = 0;
    let rising = false;
    const sort = () => {
      rising = !rising;
      const rows = [...table.tBodies[0].rows];
      const key = (row) => row.cells[column].textContent;
      rows.sort((a, b) => (rising ? 1 : -1) * key(a).localeCompare(key(b), "en", { numeric: true }));
      table.tBodies[0].append(...rows);
    };
    head.onclick = sort;
    head.onkeydown = (e) => { if (e.key === "Enter") sort(); };
  });
})();
