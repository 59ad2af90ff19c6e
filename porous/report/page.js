"use strict";
// Tables that sort, and plots that answer; without it the page stands as it is.
(() => {
  const valueOf = (row, column) => {
    const cell = row.cells[column];
    const told = cell.dataset.value;
    if (told === undefined) return cell.textContent.trim();
    return told === "" ? NaN : told === "inf" ? Infinity : told === "-inf" ? -Infinity : +told;
  };

  const compare = (a, b, sign) => {
    if (typeof a === "string") return sign * a.localeCompare(b, "en", { numeric: true });
    if (Number.isNaN(a) || Number.isNaN(b)) return Number.isNaN(a) - Number.isNaN(b);
    return a === b ? 0 : sign * (a < b ? -1 : 1);
  };

  const sort = (table, head, column) => {
    const up = head.getAttribute("aria-sort") !== "ascending";
    for (const other of head.parentNode.cells) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", up ? "ascending" : "descending");
    const body = table.tBodies[0];
    const rows = [...body.rows].map((row) => [valueOf(row, column), row]);
    rows.sort((a, b) => compare(a[0], b[0], up ? 1 : -1));
    body.append(...rows.map((pair) => pair[1]));
  };

  for (const table of document.querySelectorAll("table.sortable")) {
    [...table.tHead.rows[0].cells].forEach((head, column) => {
      const button = document.createElement("button");
      button.type = "button";
      button.append(...head.childNodes);
      button.addEventListener("click", () => sort(table, head, column));
      head.append(button);
    });
  }

  const reveal = () => {
    const target = location.hash && document.getElementById(location.hash.slice(1));
    const closed = target && target.closest("details:not([open])");
    if (closed) closed.open = true;
  };
  addEventListener("hashchange", reveal);
  reveal();

  const unpacked = async (text) => {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Response(stream).text();
  };

  // Named one by one: plotly's own choice has a button that sends data to its makers.
  const BUTTONS = [["zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"]];
  const HOW = { responsive: true, displaylogo: false, plotlyServerURL: "", modeBarButtons: BUTTONS };

  const draw = async (place, figure) => {
    const still = place.closest("figure").querySelector(".still");
    place.hidden = false;
    await Plotly.newPlot(place, figure.data, figure.layout, HOW);
    const [first, ...others] = place.querySelectorAll(".main-svg");
    first.setAttribute("role", "img");
    first.setAttribute("aria-label", still.getAttribute("aria-label"));
    for (const other of others) other.setAttribute("aria-hidden", "true");
    still.hidden = true;
    const save = document.createElement("button");
    save.type = "button";
    save.textContent = "Save the plot as SVG";
    const name = place.dataset.figure.replace(/^plot-\d+-/, "");
    save.addEventListener("click", () =>
      Plotly.downloadImage(place, { format: "svg", width: 900, height: 500, filename: name }));
    place.closest("figure").querySelector("figcaption").after(save);
  };

  const plots = async () => {
    const packed = document.getElementById("plotly");
    if (!packed || !window.DecompressionStream) return;
    const script = document.createElement("script");
    script.textContent = await unpacked(packed.textContent);
    document.head.append(script);
    const figures = JSON.parse(document.getElementById("figures").textContent);
    for (const place of document.querySelectorAll(".drawn")) {
      await draw(place, figures[place.dataset.figure]);
      await new Promise((go) => setTimeout(go));
    }
    document.documentElement.dataset.plots = "drawn";
  };
  plots();
})();
