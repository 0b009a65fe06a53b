// Draws the page's figures in the page's colours, light or dark, and lets a click on a time axis move the playback.
(() => {
  "use strict";
  const root = document.documentElement;
  const colour = (name) => getComputedStyle(root).getPropertyValue(name).trim();

  function template() {
    const axis = {
      gridcolor: colour("--grid"), linecolor: colour("--faint"), zerolinecolor: colour("--rule"),
      tickcolor: colour("--faint"), ticks: "outside", ticklen: 4, showline: true, automargin: true,
      title: { standoff: 8, font: { size: 13 } },
    };
    return {
      layout: {
        paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
        font: { family: colour("--sans"), size: 12.5, color: colour("--ink") },
        xaxis: axis, yaxis: axis, hovermode: "x unified",
        hoverlabel: { bgcolor: colour("--paper"), bordercolor: colour("--rule"), font: { color: colour("--ink") } },
        annotationdefaults: { font: { color: colour("--muted"), size: 12 }, showarrow: false },
        legend: { bgcolor: "rgba(0,0,0,0)" },
        modebar: { bgcolor: "rgba(0,0,0,0)", color: colour("--rule"), activecolor: colour("--accent") },
      },
    };
  }

  const config = {
    responsive: true, displaylogo: false, displayModeBar: "hover",
    modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"],
  };

  async function draw(div) {
    const figure = div.figure ??= JSON.parse(div.querySelector("script").textContent);
    if (!div.drawn) div.replaceChildren();
    await Plotly.react(div, figure.data, { ...figure.layout, template: template(), autosize: true }, config);
    if (div.drawn) return;
    div.drawn = true;
    if ("timeAxis" in div.dataset) div.on("plotly_click", (event) => {
      const time = event.points[0].x;
      document.querySelectorAll(".playback").forEach((p) => p.dispatchEvent(new CustomEvent("seek", { detail: time })));
    });
  }

  async function drawAll() {
    for (const div of document.querySelectorAll(".plot")) {
      await draw(div);
      await new Promise((done) => setTimeout(done));  // stay responsive between figures
    }
    root.dataset.figures = document.querySelectorAll(".plot .main-svg").length ? "drawn" : "none";
  }

  function paint(theme) {
    root.dataset.theme = theme;
    dispatchEvent(new Event("themechange"));
    drawAll();
  }
  const dark = matchMedia("(prefers-color-scheme: dark)");
  dark.addEventListener("change", () => paint(dark.matches ? "dark" : "light"));
  document.getElementById("theme").addEventListener("click", () => paint(root.dataset.theme === "dark" ? "light" : "dark"));
  drawAll();
})();
