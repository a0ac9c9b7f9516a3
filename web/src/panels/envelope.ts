// A curve with more samples than pixels: the least and the greatest of every pixel, in the order in which they came.
// Drawn, that is the picture of every sample; drawing it costs a fraction.

export class Envelope {
  /** times [s] of the points; two per pixel, or the samples themselves where there are few */
  times: Float64Array = new Float64Array();
  private readonly edges: number[] = [];
  private thick = false;

  /** Prepare for the samples at `times`, first of them at index 0, on `pixels` from `from` to `to` [s]. */
  layOut(times: Float64Array, from: number, to: number, pixels: number): void {
    this.thick = times.length > 4 * pixels;
    this.edges.length = 0;
    if (!this.thick) {
      this.times = times;
      return;
    }
    // Pixels at whole multiples of their width: a sample stays with its neighbours while the window moves on.
    const width = (to - from) / pixels;
    let last = NaN;
    for (let i = 0; i < times.length; i++) {
      const pixel = Math.floor(times[i]! / width);
      if (pixel === last) continue;
      this.edges.push(i);
      last = pixel;
    }
    this.edges.push(times.length);
    const count = this.edges.length - 1;
    this.times = new Float64Array(2 * count);
    for (let k = 0; k < count; k++) {
      this.times[2 * k] = times[this.edges[k]!]!;
      this.times[2 * k + 1] = times[this.edges[k + 1]! - 1]!;
    }
  }

  /** The points' values for a curve whose sample `i` is `value(i)`. */
  of(value: (i: number) => number): Float64Array {
    const points = new Float64Array(this.times.length);
    if (!this.thick) {
      for (let i = 0; i < points.length; i++) points[i] = value(i);
      return points;
    }
    for (let k = 0; 2 * k < points.length; k++) {
      let low = this.edges[k]!;
      let high = low;
      let least = value(low);
      let most = least;
      for (let i = low + 1; i < this.edges[k + 1]!; i++) {
        const y = value(i);
        if (y < least) [least, low] = [y, i];
        else if (y > most) [most, high] = [y, i];
      }
      points[2 * k] = low <= high ? least : most;
      points[2 * k + 1] = low <= high ? most : least;
    }
    return points;
  }
}
