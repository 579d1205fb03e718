    float square = dot(b[0], b[0]);
    b *= square > 0.0 ? rsqrt(square) : 1.0; // 2
