// Helpers of all charts: colours of the table, packed recordings (softarm/reporting/plot.py) and the look of uPlot's axes.

/* exported tableColour, unpackedBytes, unpackedLevels, sampleAt, chartAxis, chartSeries, paddedRange */
const tableColour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

const unpackedBytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;

// Return the values of packed 16-bit levels; null where there is none.
function unpackedLevels(packed) {
  const step = (packed.high - packed.low) / 65534;
  return Array.from(new Uint16Array(unpackedBytes(packed.levels)), (level) => (level === 65535 ? null : packed.low + level * step));
}

// Return the index of the last stamp that is not after a time, or -1.
function sampleAt(stamps, time) {
  let low = 0, high = stamps.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (stamps[middle] <= time) low = middle + 1; else high = middle;
  }
  return low - 1;
}

function chartAxis(more) {
  const [soft, line] = [tableColour("soft"), tableColour("line")];
  return { stroke: soft, font: "11px system-ui, sans-serif", grid: { stroke: line, width: 1 }, ticks: { stroke: line, size: 4, width: 1 }, ...more };
}

// A curve is {name, colour, width, dash}; dash is optional.
const chartSeries = (curves) => [{}, ...curves.map(({ name, colour, width, dash }) => ({ label: name, stroke: tableColour(colour), width, dash, points: { show: false } }))];

// Return the range of an axis with a margin around the extremes of its curves.
function paddedRange(low, high) {
  if (low === null || low === undefined) return [-1, 1];
  const margin = 0.06 * (high - low) || Math.abs(high) * 0.1 || 1;
  return [low - margin, high + margin];
}
