// Min-max decimation of a curve with more samples than pixels: minimum and maximum per pixel, in order of time.
// It looks like a plot of all samples at a fraction of the cost.

export class Envelope {
  /** times of the points [s]: two per pixel, or all samples if there are few */
  times: Float64Array = new Float64Array();
  private readonly edges: number[] = [];
  private decimated = false;

  /** Assign the samples at `times` to `pixels` pixels from `from` to `to` [s]. */
  layOut(times: Float64Array, from: number, to: number, pixels: number): void {
    this.decimated = times.length > 4 * pixels;
    this.edges.length = 0;
    if (!this.decimated) {
      this.times = times;
      return;
    }
    // Bins at integer multiples of the pixel width, so that the curve does not flicker while the window moves.
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

  /** Values of the points for a curve whose sample `i` is `value(i)`. */
  of(value: (i: number) => number): Float64Array {
    const points = new Float64Array(this.times.length);
    if (!this.decimated) {
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
