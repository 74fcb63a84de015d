// A browser without a locale (LANG=C, as on a bare kiosk) has a language that no formatter takes; uPlot makes one as it loads.
try {
  new Intl.NumberFormat(navigator.language);
} catch {
  Object.defineProperty(navigator, "language", { value: "en" });
}
