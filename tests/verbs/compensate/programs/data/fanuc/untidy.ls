/PROG untidy
/ATTR
COMMENT = "/MN is not here";
/MN
:R[30]=60.0;
1: L P[1] 240cm/min CNT100 COORD ;
: Weave Sine[5];
   2:  // L P[2] 100mm/sec FINE ;
--eg:L P[2] 100mm/sec FINE
2:l p[2] 100mm/sec FINE
3:L  P[3:see P1, or L 2] 100mm/sec FINE    ;
4:  MESSAGE[L P[1] 100mm/sec] ;
5:  CALL MOVE_TO('L P[2] 10mm/sec', P[2]) ;
6:L P[4] 100mm/sec FINE ;
7:W P[1] 100mm/sec FINE ;
8:L P[5] 100mm/sec FINE ;
/POS
P[1] {
 UF : 1, UT : 1, CONFIG: 'N U T, 0, 0, 0',
 X = 388.383453 mm, Y = -228.108169 mm, Z = 516.297239 mm,
 W = 156.348020 deg, P = -1.933341 deg, R = -41.808096 deg
};
P[2]{
   GP1:
  UF : 1, UT : 1, CONFIG : 'N U T, 0, 0, 0',
  X=	-57.57	mm,
  Y=	-210.82	mm, Z=	355.83 mm, W = -176.7157 deg, P = -14.3577 deg, R = -21.1877 deg
};
P[3:"see P1, or L 2"]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =   589.308  mm,	Y =    10.639  mm,	Z =   661.918  mm,
	W =   159.954 deg,	P =   -35.303 deg,	R =  -103.117 deg
};
P[4]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = ********  mm,	Y = ********  mm,	Z = ********  mm,
	W = ******** deg,	P = ******** deg,	R = ******** deg
};
P[9]{
   GP1:
	UF : 1, UT : 1,		CONFIG : '',
	X =     1.000  mm,	Y =     2.000  mm,	Z =     3.000  mm,
	W =     0.000 deg,	P =     0.000 deg,	R =     0.000 deg
};
/END