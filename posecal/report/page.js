// Tables that sort, and reliability diagrams that name their joints.
{
  const compare = (a, b) => {
    const [x, y] = [a.dataset.key, b.dataset.key];
    if (x !== undefined && y !== undefined) {
      return Number(x) - Number(y);
    }
    if (x !== undefined || y !== undefined) {
      return x === undefined ? 1 : -1; // unknown numbers last
    }
    return a.textContent.localeCompare(b.textContent, undefined, { numeric: true });
  };

  const sort = (table, column, heading) => {
    const descending = heading.getAttribute("aria-sort") === "ascending";
    for (const other of table.tHead.rows[0].cells) {
      other.removeAttribute("aria-sort");
    }
    heading.setAttribute("aria-sort", descending ? "descending" : "ascending");
    const body = table.tBodies[0];
    const rows = [...body.rows].sort((a, b) => compare(a.cells[column], b.cells[column]));
    if (descending) {
      const isKnown = (row) => row.cells[column].dataset.key !== undefined;
      const known = rows.some(isKnown) ? rows.filter(isKnown) : rows;
      rows.splice(0, known.length, ...known.reverse());
    }
    body.append(...rows);
  };

  for (const table of document.querySelectorAll("table.sortable")) {
    [...table.tHead.rows[0].cells].forEach((heading, column) => {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = heading.textContent;
      button.addEventListener("click", () => sort(table, column, heading));
      heading.replaceChildren(button);
    });
  }
}

{
  const figures = [...document.querySelectorAll(".diagram")];
  const groups = document.getElementById("diagram-group");
  const joints = document.getElementById("diagram-joint");

  const choose = (name) => {
    joints.value = name;
    for (const figure of figures) {
      const caption = figure.querySelector("figcaption");
      caption.textContent = "Point at a curve to name its joint.";
      for (const path of figure.querySelectorAll(".joint")) {
        const isChosen = path.dataset.joint === name;
        path.classList.toggle("chosen", isChosen);
        if (isChosen) {
          caption.textContent = `${name}: ${path.dataset.said}`;
        }
      }
    }
  };

  // The nearest curve within reach of the pointer: thin lines are hard to hit.
  const nearest = (svg, event) => {
    const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    let best = { distance: 14, name: null };
    for (const path of svg.querySelectorAll(".joint")) {
      const points = path.getAttribute("d").slice(1).split("L");
      const ends = points.map((pair) => pair.split(" ").map(Number));
      for (let i = 1; i < ends.length; i += 1) {
        const [[x0, y0], [x1, y1]] = [ends[i - 1], ends[i]];
        if (point.x >= x0 && point.x <= x1) {
          const y = y0 + ((y1 - y0) * (point.x - x0)) / Math.max(x1 - x0, 1e-9);
          const distance = Math.abs(y - point.y);
          if (distance < best.distance) {
            best = { distance, name: path.dataset.joint };
          }
        }
      }
    }
    return best.name;
  };

  if (figures.length > 0) {
    const names = new Set([...document.querySelectorAll(".diagram .joint")].map((path) => path.dataset.joint));
    for (const name of names) {
      joints.add(new Option(name, name));
    }
    joints.addEventListener("change", () => choose(joints.value));
    groups.addEventListener("change", () => {
      figures.forEach((figure, number) => {
        figure.hidden = number !== groups.selectedIndex;
      });
    });
    for (const figure of figures) {
      const svg = figure.querySelector("svg");
      svg.addEventListener("pointermove", (event) => {
        const name = nearest(svg, event);
        if (name !== null && name !== joints.value) {
          choose(name);
        }
      });
    }
  }
}
