"use strict";
// Shows the rows that have the words and the state that are asked for.
const words = document.getElementById("words");
const state = document.getElementById("state");
const shown = document.getElementById("shown");
const rows = [...document.querySelectorAll("#rows tr")];

function filter() {
  const wanted = words.value.toLowerCase().split(/\s+/).filter(Boolean);
  let count = 0;
  for (const row of rows) {
    const text = row.textContent.toLowerCase();
    const fits = (!state.value || row.dataset.state === state.value) && wanted.every((word) => text.includes(word));
    row.hidden = !fits;
    count += fits ? 1 : 0;
  }
  shown.textContent = count === rows.length ? "" : `${count} of ${rows.length} shown`;
}

words.addEventListener("input", filter);
state.addEventListener("change", filter);
