    let square = dot(mixed[0], mixed[0]);
    let b = select(1.0, inverseSqrt(square), square > 0.0) * mixed; // 2
